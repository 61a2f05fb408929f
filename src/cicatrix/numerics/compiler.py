"""How laws and elements are compiled."""

# XLA's fused code generator takes twice as long to compile such kernels, and they run no faster for it
COMPILER = {"xla_cpu_use_fusion_emitters": False}
