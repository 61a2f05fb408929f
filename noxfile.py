"""Tasks: lint, types, layers, test, bench."""

import nox

nox.options.sessions = ["lint", "types", "layers", "test"]
nox.options.reuse_existing_virtualenvs = True
nox.options.default_venv_backend = (
    "uv|virtualenv"  # uv, where it is installed, fetches a version of Python that is missing
)
PYTHONS = ("3.11", "3.12", "3.13")  # as in the classifiers of pyproject.toml


@nox.session
def lint(session: nox.Session) -> None:
    """Lint, and check the format."""
    session.install("ruff>=0.9")
    session.run("ruff", "check", ".")
    session.run("ruff", "format", "--check", ".")


@nox.session
def types(session: nox.Session) -> None:
    """Check the types."""
    session.install(".[dev]")
    session.run("pyright", *session.posargs)


@nox.session
def layers(session: nox.Session) -> None:
    """Check that imports go only downwards."""
    session.install(".[dev]")
    session.run("lint-imports")


@nox.session(python=PYTHONS)
def test(session: nox.Session) -> None:
    """Run the tests against the installed package, on every version of Python that is found."""
    session.install(".[test]")
    session.run("pytest", *(session.posargs or ["-n", "2"]))


@nox.session
def slow(session: nox.Session) -> None:
    """Run the slow tests: the papers and the examples in full."""
    session.install(".[test]")
    session.run("pytest", "-m", "slow", *session.posargs)


@nox.session
def bench(session: nox.Session) -> None:
    """Measure speed."""
    session.install(".")
    session.run("cicatrix", "bench", *session.posargs)
