"""cicatrix: predict how soft tissue heals after surgery."""

__version__ = "0.1.0"
