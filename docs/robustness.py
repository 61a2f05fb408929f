"""Damage inputs of every kind in many ways, and count what the program makes of them.

``python docs/robustness.py`` writes the table into ``docs/robustness.md`` and prints every wrong one with the command that makes
it again; ``--number`` says how many inputs, ``--kind`` and ``--only`` pick one of them, ``--json FILE`` writes the counts.
Each input is read in a process of its own that ends after 10 s and has 3 GB of address space.
"""

from __future__ import annotations

import argparse
import json
import os
import pickle
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import robustness_inputs as inputs
from robustness_damage import DAMAGES, Damage
from robustness_inputs import KINDS, Values

from cicatrix.core.errors import InputError

SECONDS, MEMORY = 10.0, 3 << 30  # limits of one input [s], [B]
REFUSED, RIGHT, WRONG = "refused", "accepted right", "wrong"
VERDICTS = (REFUSED, RIGHT, WRONG)
PAGE = Path(__file__).with_name("robustness.md")
MARKS = "<!-- table -->", "<!-- /table -->"


class Outcome(NamedTuple):
    """What became of reading an input."""

    state: str
    """"refused", "accepted", or what else happened."""
    words: str = ""
    values: Values | None = None


def apart(job: Callable[[], Outcome], folder: Path) -> Outcome:
    """Run a job in a process of its own, within the limits."""
    result = folder / "result.pickle"
    child = os.fork()
    if child == 0:
        _run(job, result)
    end, status = time.monotonic() + SECONDS, None
    while status is None and time.monotonic() < end:
        found, code = os.waitpid(child, os.WNOHANG)
        status = code if found else None
        time.sleep(0.002)
    if status is None:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        return Outcome("hang", f"no end within {SECONDS:g} s")
    if os.WIFSIGNALED(status):
        return Outcome("crash", f"the process died of signal {os.WTERMSIG(status)}")
    return pickle.loads(result.read_bytes()) if result.is_file() else Outcome("crash", "the process left nothing")


def _run(job: Callable[[], Outcome], result: Path) -> None:
    """Run the job in the child process, and leave it."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    quiet = os.open(os.devnull, os.O_RDWR)
    os.dup2(quiet, 1)
    os.dup2(quiet, 2)
    try:
        outcome = job()
    except BaseException as error:  # whatever it is, it is the verdict
        outcome = Outcome(type(error).__name__, _place(error))
    result.write_bytes(pickle.dumps(outcome))
    os._exit(0)


def _place(error: BaseException) -> str:
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if "cicatrix" in frame.filename]
    at = f" at {Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else ""
    return f"{str(error)[:120]}{at}"


def read(kind: str, folder: Path) -> Outcome:
    """Read the files of a folder."""
    try:
        return Outcome("accepted", values={name: np.asarray(v) for name, v in KINDS[kind].read(folder).items()})
    except InputError as error:
        return Outcome(REFUSED, str(error))


def differing(one: Values, other: Values) -> float:
    """Return the number of entries in which two tables of values differ; infinity where they have not the same form."""
    if one.keys() != other.keys():
        return np.inf
    pairs = [(np.asarray(one[name]), np.asarray(other[name])) for name in one]
    if any(a.shape != b.shape for a, b in pairs):
        return np.inf
    return float(sum(np.count_nonzero(~_same(a, b)) for a, b in pairs))


def _same(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    if a.dtype.kind in "fiub" and b.dtype.kind in "fiub":
        return np.isclose(a.astype(float), b.astype(float), rtol=1e-6, atol=0.0, equal_nan=True)
    return np.asarray(a.astype(str) == b.astype(str))


def judged(kind: str, folder: Path, sound: Outcome, found: Outcome, damage: Damage) -> tuple[str, str]:
    """Return the verdict on what became of a damaged input, and the reason if it is wrong."""
    if found.state == REFUSED:
        return (
            (REFUSED, found.words) if is_sentence(found.words) else (WRONG, f"refused without a reason: {found.words}")
        )
    if found.state != "accepted":
        return WRONG, f"{found.state}: {found.words}"
    assert found.values is not None
    if sound.values is not None and differing(sound.values, found.values) == 0:
        return RIGHT, ""
    if sound.values is not None and not _as_finite(sound.values, found.values):
        return WRONG, "accepted with values that are not finite"
    says = KINDS[kind].says
    try:
        if says is not None and differing(says(folder), found.values) == 0:
            return RIGHT, "as the file says"
    except Exception as error:  # the plain reading cannot make sense of the file: only the count below can
        del error
    n = differing(sound.values or {}, found.values)
    return (RIGHT, "another value") if n <= damage.n_changed else (WRONG, f"accepted with {n:g} other values")


def is_sentence(words: str) -> bool:
    """Return whether a refusal gives a reason in words, and not only the text of an exception such as "1" or "'Points'"."""
    return 60 <= len(words) < 1500 or len(words.rpartition(": ")[2].split()) >= 3


def _as_finite(sound: Values, found: Values) -> bool:
    """Return whether no column of ``found`` has a value that is not finite where that of ``sound`` has none."""

    def finite(values: Any) -> bool:
        array = np.asarray(values)
        return array.dtype.kind != "f" or bool(np.isfinite(array).all())

    return all(finite(values) or (name in sound and not finite(sound[name])) for name, values in found.items())


def tried(kind: str, number: int, sound: Outcome, home: Path) -> tuple[str, str, str]:
    """Damage an input in the way of its number; return verdict, reason and the words for the damage."""
    folder = home / "damaged"
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(inputs.SOUND / kind_folder(kind), folder)
    names = json.loads((folder / "names.json").read_text())
    rng = np.random.default_rng([number, *kind.encode()])
    path = folder / names[number % len(names)]
    damage = DAMAGES[number % len(DAMAGES)](path.read_bytes(), rng)
    path.unlink()
    path = path.with_name(path.name.split(".")[0] + damage.ending) if damage.ending else path
    path.write_bytes(damage.content)
    found = apart(lambda: read(kind, folder), home)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        verdict, reason = judged(kind, folder, sound, found, damage)
    return verdict, reason, f"{path.relative_to(folder)} {damage.words}"


def kind_folder(kind: str) -> str:
    """Return the name of the folder of a kind's sound input."""
    return "case" if kind.startswith("case file") else "".join(c if c.isalnum() else "-" for c in kind)


def made(kind: str, home: Path) -> Outcome:
    """Write the sound input of a kind, and read it."""
    folder = inputs.SOUND / kind_folder(kind)
    folder.mkdir(parents=True)

    def job() -> Outcome:
        (folder / "names.json").write_text(json.dumps(KINDS[kind].write(folder)))
        copy = shutil.copytree(folder, home / "copy")  # reading may write, as the end of a run
        return read(kind, copy)

    outcome = apart(job, home)
    shutil.rmtree(home / "copy", ignore_errors=True)
    if outcome.state != (REFUSED if kind in inputs.NEVER else "accepted"):
        raise SystemExit(f"{kind}: the sound input gives {outcome.state}: {outcome.words}")
    return outcome


def results(kinds: list[str], numbers: dict[str, range]) -> Iterator[tuple[str, int, str, str, str]]:
    """Yield kind, number, verdict, reason and damage of every input."""
    with tempfile.TemporaryDirectory() as place:
        home = Path(place)
        inputs.SOUND = home / "sound"
        made("case file (TOML)", home)
        for kind in kinds:
            if kind == "case file (TOML)":
                sound = apart(lambda: read("case file (TOML)", inputs.SOUND / "case"), home)
            else:
                sound = made(kind, home)
            for number in numbers[kind]:
                (home / "result.pickle").unlink(missing_ok=True)
                yield kind, number, *tried(kind, number, sound, home)


def table(counts: dict[str, Counter[str]]) -> str:
    """Return the counts as a table in Markdown, with a row of their sums."""
    total = sum(counts.values(), Counter())
    head = ["| kind of input | tried | refused in a sentence | accepted right | wrong |", "|---|---|---|---|---|"]
    rows = [(kind, counts[kind]) for kind in counts] + [("**all**", total)]
    return "\n".join(
        head + [f"| {kind} | {sum(c.values())} | {c[REFUSED]} | {c[RIGHT]} | {c[WRONG]} |" for kind, c in rows]
    )


def main() -> int:
    """Run, print the wrong ones, and write the page or the counts; return 1 if any is wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--number", type=int, default=20 * len(KINDS), help="how many inputs, over all kinds")
    parser.add_argument("--kind", choices=list(KINDS), help="this kind alone")
    parser.add_argument("--only", type=int, help="the input of this number alone")
    parser.add_argument("--json", type=Path, help="write the counts and the wrong ones here, and no page")
    args = parser.parse_args()
    kinds = [args.kind] if args.kind else list(KINDS)
    each, more = divmod(args.number, len(kinds))
    ranges = {kind: range(each + (place < more)) for place, kind in enumerate(kinds)}
    if args.only is not None:
        ranges = {kind: range(args.only, args.only + 1) for kind in kinds}
    counts: dict[str, Counter[str]] = {kind: Counter() for kind in kinds}
    wrong = []
    for kind, number, verdict, reason, damage in results(kinds, ranges):
        counts[kind][verdict] += 1
        if args.only is not None or verdict == WRONG:
            again = f'python docs/robustness.py --kind "{kind}" --only {number}'
            print(f"{verdict}: {kind}, {damage}: {reason}\n    {again}", flush=True)
        if verdict == WRONG:
            wrong.append({"kind": kind, "number": number, "damage": damage, "reason": reason})
    print(table(counts))
    if args.json:
        args.json.write_text(json.dumps({"counts": {k: dict(c) for k, c in counts.items()}, "wrong": wrong}, indent=1))
    elif args.only is None and not args.kind:
        text = PAGE.read_text(encoding="utf-8")
        before, _, rest = text.partition(MARKS[0])
        PAGE.write_text(
            f"{before}{MARKS[0]}\n{table(counts)}\n{MARKS[1]}{rest.partition(MARKS[1])[2]}", encoding="utf-8"
        )
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
