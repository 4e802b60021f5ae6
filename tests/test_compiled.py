"""Compiled loops that are kept on disk are never those of another version of the code."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import physics

CALLEE = "from .machinery.compiled import compiled\n\n@compiled()\ndef f():\n    return {}\n"
CALLER = (
    CALLEE.format("g()").replace("def f", "def h").replace("\n\n@", "\nfrom .b import f as g\n@")
)


def test_a_change_in_another_file_counts(tmp_path):
    """numba looks for changes in a function's own file alone, not in what that calls."""
    here, package = Path(physics.__file__).parent, tmp_path / "p"
    (package / "machinery").mkdir(parents=True)
    for name in ("compiled.py", "provenance.py"):
        shutil.copy(here / "machinery" / name, package / "machinery")
    (package / "a.py").write_text(CALLER)
    environment = {k: v for k, v in os.environ.items() if not k.startswith("NUMBA_")}
    environment["PYTHONDONTWRITEBYTECODE"] = "1"
    for value in (1, 2):
        (package / "b.py").write_text(CALLEE.format(value))
        found = subprocess.run(
            [sys.executable, "-c", "from p.a import h; print(h())"],
            cwd=tmp_path, env=environment, capture_output=True, text=True, check=True,
        )  # fmt: skip
        assert int(found.stdout) == value
    assert list(package.rglob("*.nbi")), "nothing was kept"
