"""Arguments of the command line: every verb with its options, without the code that runs it.

The module of a verb has the verb's name and holds ``run(args)``; the command line imports it once the verb is known.
"""

from __future__ import annotations

import argparse
import os
import re
from pathlib import Path
from typing import NoReturn

from ..bench.benchmarks import BENCHMARKS
from ..core.errors import InputError
from ..core.positions import POSITIONS
from ..core.version import __version__
from ..files.numerals import Numerals
from ..files.opening import LARGEST_NAME

LONGEST_NAME = 255  # bytes of a name within a path, in the file systems of today
LARGEST_PORT = 2**16 - 1
AFTER_DEMO = "; the last checkpoint is kept; run the same command again to continue"
AFTER_RUN = "; to continue from the last checkpoint, run the same command with --resume"


class Parser(argparse.ArgumentParser):
    """Argument parser that reports a wrong command in one sentence."""

    def error(self, message: str) -> NoReturn:
        """Raise an InputError with the message instead of printing the usage."""
        raise InputError(f"{message}; see {self.prog} --help")


def build_parser() -> Parser:
    """Build the argument parser with all verbs."""
    parser = Parser(
        prog="cicatrix",
        description="Compute the shape of a breast after healing from an image and a planned lumpectomy.",
        epilog="Exit codes: 0 done, 2 error in the input, 3 no convergence or an internal error, 130 interrupted.",
        allow_abbrev=False,
    )
    parser.add_argument("--version", action="version", version=f"cicatrix {__version__}")
    verbs = parser.add_subparsers(title="verbs", dest="verb", metavar="VERB", required=True)
    for add in (_demo, _run, _check, _segment, _mesh, _fit, _report, _plan, _bench):  # as a new user needs them
        add(verbs)
    return parser


def _demo(verbs: argparse._SubParsersAction) -> None:
    words = "run a 2-D lumpectomy on the built-in phantom, from image to healed shape"
    parser = verbs.add_parser("demo", help=words, allow_abbrev=False)
    parser.add_argument(
        "--out", metavar="DIR", type=_path, default=Path("demo"), help="folder for the results (default: demo)"
    )
    parser.set_defaults(after_interruption=AFTER_DEMO)


def _run(verbs: argparse._SubParsersAction) -> None:
    parser = verbs.add_parser("run", help="run a case file", allow_abbrev=False)
    _add_case(parser)
    parser.add_argument(
        "--out",
        metavar="DIR",
        type=_path,
        help="folder for the results (default: runs/NAME, with the name of the case file)",
    )
    parser.add_argument("--resume", action="store_true", help="continue from the last checkpoint in the folder")
    _add_overrides(parser)
    parser.set_defaults(after_interruption=AFTER_RUN)


def _check(verbs: argparse._SubParsersAction) -> None:
    words = "check a case file, and the files that it names, without running it; one line per fault"
    parser = verbs.add_parser("check", help=words, allow_abbrev=False)
    _add_case(parser)
    parser.add_argument(
        "data", metavar="DATA.csv", type=Path, nargs="?", help="measured data, to check them as cicatrix fit reads them"
    )
    _add_overrides(parser)


def _segment(verbs: argparse._SubParsersAction) -> None:
    parser = verbs.add_parser("segment", help="segment one breast in an MRI into labels and tissue probabilities")
    parser.add_argument("image", metavar="IMAGE", type=_path, help="NIfTI, NRRD or MHA file, or a DICOM folder")
    parser.add_argument("--out", type=_path, required=True, metavar="DIR", help="folder to write; must be new or empty")
    parser.add_argument("--weighting", choices=("t1", "t1-fatsat"), default="t1")
    parser.add_argument("--side", choices=("left", "right"), default="left", help="side of the patient's breast")
    parser.add_argument("--position", choices=tuple(POSITIONS), default="prone")
    _add_axes(parser)
    parser.add_argument(
        "--chest-wall-plane",
        nargs=6,
        type=_number,
        metavar=("X", "Y", "Z", "NX", "NY", "NZ"),
        help="chest wall given by a point [mm, LPS] and a normal, instead of finding it automatically",
    )
    parser.add_argument(
        "--resection-centre",
        nargs=3,
        type=_number,
        metavar=("X", "Y", "Z"),
        help="label a bright mass at this point [mm, LPS] as tumour",
    )


def _add_label_names(parser: argparse.ArgumentParser) -> None:
    words = "tissue of a segment, or of a value, that is not known, such as FGT=gland or 7=skin; may be repeated"
    parser.add_argument("--label-name", metavar="NAME=TISSUE", action="append", default=[], help=words)


def _mesh(verbs: argparse._SubParsersAction) -> None:
    parser = verbs.add_parser("mesh", help="mesh a labelled breast with tetrahedra, for cases of kind equilibrium")
    parser.add_argument(
        "labels", metavar="LABELS", type=_path, help="label map: 0 air, 1 fat, 2 gland, 3 skin, 4 tumour"
    )
    parser.add_argument("--out", type=_path, required=True, metavar="FILE", help="VTU file to write; must not exist")
    parser.add_argument("--edge-mm", type=_number, default=5.0, help="element edge [mm], 5 by default")
    _add_axes(parser)
    _add_label_names(parser)


def _fit(verbs: argparse._SubParsersAction) -> None:
    parser = verbs.add_parser(
        "fit", help="fit parameters of a law to measured stretches and stresses", allow_abbrev=False
    )
    _add_case(parser)
    words = "measurements with the columns of a run's history.csv: time_h, lambda_x, sigma_x_kPa, ..."
    parser.add_argument("data", metavar="DATA.csv", type=_path, help=words)
    words = "a parameter to fit, with its bounds, such as law.0.mu_kPa=0.1..10; may be repeated"
    parser.add_argument("--free", metavar="KEY=LOW..HIGH", action="append", required=True, help=words)
    parser.add_argument(
        "--out",
        metavar="DIR",
        type=_path,
        help="folder for the results (default: fits/NAME, with the name of the data file)",
    )
    _add_overrides(parser)


def _report(verbs: argparse._SubParsersAction) -> None:
    words = "write web pages about a run (finished or not) that open offline; several runs are compared"
    parser = verbs.add_parser("report", help=words, allow_abbrev=False)
    parser.add_argument(
        "runs", metavar="DIR", nargs="+", type=_path, help="folder of a run; give several to compare them"
    )
    parser.add_argument(
        "--out",
        metavar="DIR",
        type=_path,
        help="folder for the pages (default: DIR/report; for several runs: comparison)",
    )


def _plan(verbs: argparse._SubParsersAction) -> None:
    words = "open a local page to place a resection, save it as a case, run it and watch it"
    parser = verbs.add_parser("plan", help=words, allow_abbrev=False)
    parser.add_argument(
        "image",
        metavar="IMAGE",
        nargs="?",
        type=_path,
        help="NIfTI, NRRD or MHA file, or a DICOM folder (default: the built-in phantom)",
    )
    parser.add_argument("--labels", metavar="FILE", type=_path, help="label map to use instead of segmenting the image")
    _add_label_names(parser)
    parser.add_argument("--weighting", choices=("t1", "t1-fatsat"), default="t1")
    parser.add_argument("--side", choices=("left", "right"), default="left", help="side of the patient's breast")
    parser.add_argument("--position", choices=tuple(POSITIONS), default="prone", help="position in the image")
    _add_axes(parser)
    parser.add_argument(
        "--out", metavar="DIR", type=_path, default=Path("plan"), help="folder for cases and runs (default: plan)"
    )
    parser.add_argument("--port", type=_port, default=0, help="port of the page's address (default: any free port)")
    parser.add_argument("--no-browser", action="store_true", help="print the address without opening a browser")
    parser.set_defaults(after_interruption="; the planning page is closed; a run in progress has saved its state")


def _bench(verbs: argparse._SubParsersAction) -> None:
    parser = verbs.add_parser("bench", help="measure how fast the program runs", allow_abbrev=False)
    parser.add_argument("names", metavar="NAME", nargs="*", help=f"a benchmark: {', '.join(BENCHMARKS)} (default: all)")
    parser.add_argument("--json", metavar="FILE", type=_path, help="also write the measurements to this file")


def _path(text: str) -> Path:
    """Return a path that the system can open or make; argparse puts the argument before the message."""
    path = Path(text)
    longest = max((len(os.fsencode(part)) for part in path.parts), default=0)
    if not text.strip() or re.search(r"[\x00-\x1f\x7f-\x9f]", text):
        raise argparse.ArgumentTypeError(f"must name a file or folder, without control characters; got {text!r}")
    if longest > LONGEST_NAME or len(os.fsencode(text)) > LARGEST_NAME:
        words = f"a path has at most {LARGEST_NAME} bytes, and each name in it {LONGEST_NAME}"
        raise argparse.ArgumentTypeError(f"{words}; got {len(text)} characters, {text[:40]}...")
    return path


def _number(text: str) -> float:
    """Return a finite number."""
    try:
        return Numerals().number(text.strip())
    except ValueError as error:
        raise argparse.ArgumentTypeError(f"{text!r} {error}") from None


def _port(text: str) -> int:
    """Return the number of a TCP port."""
    if not text.isdecimal() or len(text) > 5 or int(text) > LARGEST_PORT:
        raise argparse.ArgumentTypeError(f"must be 0 to {LARGEST_PORT}; got {text!r}")
    return int(text)


def _add_case(parser: argparse.ArgumentParser) -> None:
    """Add the positional argument for the case file."""
    parser.add_argument("case", metavar="CASE.toml", type=_path, help="the case file")


def _add_axes(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--axes``, for images whose header does not say how they lie in the patient."""
    words = "directions of the file's x, y and z in the patient, such as LPS, in place of what the header says"
    parser.add_argument("--axes", metavar="AXES", help=words)


def _add_overrides(parser: argparse.ArgumentParser) -> None:
    """Add the option ``--set``, which may be repeated."""
    words = "override one key of the case, such as run.seed=3; may be repeated; paths are relative to the case file"
    parser.add_argument("--set", metavar="KEY.PATH=VALUE", action="append", default=[], help=words)
