"""The README's Python runs as written, on a small cube."""

import re
from pathlib import Path

import pytest
from traced import one_thread, traced  # noqa: F401

from texnet.files.cube_io import write_cube

ROOT = Path(__file__).parent.parent
BLOCKS = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.S)


@pytest.mark.parametrize("code", BLOCKS)
def test_the_python_of_the_readme_runs(code, tmp_path, monkeypatch):
    write_cube(traced("forest", 24, (24, 36), 8)[0], tmp_path / "night.exr")
    (tmp_path / "texnet").symlink_to(ROOT / "texnet")
    monkeypatch.chdir(tmp_path)
    exec(code, {})
