"""The command line with the computation replaced by three cycles that do nothing and can end with any error."""

import os
import signal
import sys
import time

import numpy as np

import cicatrix
from cicatrix.cases.reading import case_table, input_files
from cicatrix.cli import main
from cicatrix.core.errors import ConvergenceError, InputError
from cicatrix.runs.results import Quantity, RunFolder, open_run

ENDS = {
    "input": InputError("the image holds\nno breast"),
    "convergence": ConvergenceError("Newton stopped at load 0.4; try smaller steps.", ["load 0.5: residual 1e-2"]),
    "bug": ZeroDivisionError("division by zero"),
}


def simulate(case, out=None, resume=False, progress=None):
    end = os.environ.get("END", "")
    with RunFolder.open(
        out, case_table(case), seed=case.run.seed, inputs=input_files(case), resume=resume, progress=progress
    ) as folder:
        start = folder.checkpoint.cycle + 1 if folder.checkpoint else 0
        with progress.stage("cycles"):
            for cycle in range(0 if folder.already_finished else start, 3 if not folder.already_finished else 0):
                folder.record({"cycle": cycle, "time_days": 7.0 * cycle})
                folder.save_checkpoint(cycle, {"x": np.array(cycle)})
                progress.update((cycle + 1) / 3, f"cycle {cycle}")
                if end in ENDS:
                    raise ENDS[end]
                if end == "terminate":
                    os.kill(os.getpid(), signal.SIGTERM)
                    time.sleep(5)
                if end == "interrupt":
                    raise KeyboardInterrupt
        if not folder.already_finished:
            folder.write_outcome(
                {"time_to_closure_days": Quantity(14.0, "days"), "by_visit": Quantity({"week 2": 1.0}, "mm")}
            )
            folder.finish("The cavity closed on day 14.")
    return open_run(out)


cicatrix.simulate = simulate
sys.exit(main.main())
