"""Entry point of the `occlog` command and of `python -m occlog`.

`python -m` puts the current folder first on the module path, where a file `json.py` or `socket.py` would shadow
Python's own. It is removed before anything is imported, unless the program is in it, also for child processes.
"""

import os
import sys

os.environ["PYTHONSAFEPATH"] = "1"
try:
    _here = os.path.realpath(os.curdir)
except OSError:  # the current folder is gone
    _here = ""
if _here != os.path.realpath(os.path.join(os.path.dirname(__file__), os.pardir)):  # noqa: PTH118, PTH120 -- pathlib imports
    sys.path[:] = [path for path in sys.path if path and os.path.realpath(path) != _here]

from occlog.cli.main import main

if __name__ == "__main__":
    main()
