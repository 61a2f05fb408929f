"""Content-Security-Policy of the pages: they load nothing from other places."""

from __future__ import annotations


def policy(connect: str = "data: blob:", *, files: str = "file: ") -> str:
    """Return the policy of a page.

    Parameters
    ----------
    connect : str
        Sources that the page's scripts may fetch from.
    files : str
        Source that stands for the page's own folder where it is opened as a file; empty for a page that a server sends.

    Notes
    -----
    Source: W3C, Content Security Policy Level 3, section 6. A page that is opened as a file can say it in an element only, which
    knows no ``frame-ancestors`` (section 3.3); a server says it in a header.
    """
    own = f"'self' {files}"
    return (
        f"default-src 'none'; script-src {own}blob:; style-src {own}'unsafe-inline'; img-src {own}data: blob:; "
        f"font-src data:; connect-src {connect}; worker-src blob:; base-uri 'none'; form-action 'none'"
    )
