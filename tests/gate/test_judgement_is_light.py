from __future__ import annotations

import subprocess
import sys


def test_gate_report_and_rows_import_no_simulation():
    code = (
        "import sys, nw_gate, nw_eval.reporting, nw_gate.results.parquet, nw_eval.suite\n"
        "heavy = {'mujoco', 'torch', 'numba', 'onnxruntime', 'matplotlib'} & set(sys.modules)\n"
        "print(sorted(heavy))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_rows_and_verdicts_do_not_need_arrow():
    code = "import sys, nw_gate, nw_gate.results.journal; print('pyarrow' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"
