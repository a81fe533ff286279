"""Runs the code of notebooks from top to bottom, without Jupyter: `python run.py NOTEBOOK...`.

Pictures are drawn but not shown. Ends with the first fault, telling the notebook and the cell.
"""

import json
import pathlib
import sys

import matplotlib

matplotlib.use("Agg")


def run(path):
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    names = {"__name__": "__main__"}
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    for number, cell in enumerate(code, 1):
        where = f"{path.name}, cell {number} of {len(code)}"
        try:
            exec(compile("".join(cell["source"]), where, "exec"), names)
        except (Exception, SystemExit) as e:
            raise SystemExit(f"{where}: {type(e).__name__}: {e}") from e
    print(f"{path.name}: {len(code)} cells")


for name in sys.argv[1:]:
    run(pathlib.Path(name))
