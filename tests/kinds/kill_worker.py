"""Process that forks runs and ends them by signals: each line on stdin asks for one, each line on stdout says how it ended.

The package is imported once, before any fork, so that a run starts at once and nearly every moment at which it can be ended
lies in its own work.
"""

import importlib
import json
import os
import pkgutil
import signal
import sys
import time

import cicatrix
from cicatrix.cli.main import main
from cicatrix.files import atomic
from cicatrix.runs import driver

for module in pkgutil.walk_packages(cicatrix.__path__, "cicatrix."):
    if not module.name.endswith("__main__"):
        importlib.import_module(module.name)


def run(case, out, settings, interval_s, flush):
    """Run a case to its end, or until the flush of that number in writing checkpoints (0: none)."""
    driver.CHECKPOINT_SECONDS = interval_s
    force, n = atomic._force_to_disk, 0

    def dying(path):
        nonlocal n
        n += "checkpoint" in path.parts[-2:]
        if n == flush:
            os.kill(os.getpid(), signal.SIGKILL)
        force(path)

    if flush:
        atomic._force_to_disk = dying
    sink = os.open(out + ".log", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    for stream in (sys.stdout, sys.stderr):
        os.dup2(sink, stream.fileno())
    sets = [word for setting in settings for word in ("--set", setting)]
    return main(["run", case, "--out", out, "--resume", *sets])


def ended(child, seconds, number):
    """Wait for a child, and send it a signal after so many seconds (None: never); return its exit status and its seconds."""
    began = time.monotonic()
    while seconds is not None and time.monotonic() - began < seconds:
        if os.waitid(os.P_PID, child, os.WEXITED | os.WNOHANG | os.WNOWAIT):
            break
        time.sleep(min(0.002, seconds))
    if seconds is not None:
        os.kill(child, number)
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    return {"status": status, "seconds": time.monotonic() - began}


for line in sys.stdin:
    asked = json.loads(line)
    after, number = asked.pop("after_s"), asked.pop("signal")
    child = os.fork()
    if child == 0:
        code = 1
        try:
            code = run(**asked)
        finally:
            os._exit(code)
    print(json.dumps(ended(child, after, number)), flush=True)
