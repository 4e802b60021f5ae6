"""What is kept on disk is taken for what it is: other code, settings or numbers, another name."""

import numpy as np
from test_architecture import ROOT, imports

from benchmarks import rows
from physics.machinery.provenance import fingerprint, provenance
from training import train
from training.scenes import SOURCES


def test_settings_code_and_names_tell_apart(tmp_path):
    (tmp_path / "a" / "b").mkdir(parents=True)
    (tmp_path / "a" / "b" / "x.py").write_text("1")
    (tmp_path / "a" / "notes.txt").write_text("1")
    (tmp_path / "data.json").write_text("{}")
    sources = [tmp_path / "a", tmp_path / "data.json"]
    first = provenance({"k": 1}, sources)
    assert first == provenance({"k": 1}, sources) and len(first) == 16
    seen = {first, provenance({"k": 2}, sources), provenance({"k": 1}, sources[:1])}
    (tmp_path / "a" / "notes.txt").write_text("2")
    assert provenance({"k": 1}, sources) == first  # no code
    (tmp_path / "a" / "b" / "x.py").write_text("2")
    seen.add(provenance({"k": 1}, sources))
    (tmp_path / "a" / "b" / "x.py").rename(tmp_path / "a" / "b" / "y.py")
    seen.add(provenance({"k": 1}, sources))
    (tmp_path / "data.json").write_text("[]")
    seen.add(provenance({"k": 1}, sources))
    assert len(seen) == 6


def test_numbers_shapes_and_types_tell_apart():
    a = np.arange(6.0)
    arrays = [(a,), (a.reshape(2, 3),), (a[:3], a[3:]), (a.astype(np.float32),), (a + 1e-12,)]
    assert len({fingerprint(*one) for one in arrays}) == len(arrays)
    assert fingerprint(a[::2]) == fingerprint(a[::2].copy())


def test_runs_and_measurements_go_by_the_data_of_physics(monkeypatch):
    """Skies and curves are data: with other ones nothing on disk is the same run any more."""
    data, seen = ROOT / "physics" / "data", []
    monkeypatch.setattr(train, "provenance", lambda settings, sources: seen.append(sources))
    train.run_name({})
    for sources in (*seen, rows.DATA):
        assert set(data.iterdir()) <= set(sources)


def test_a_scene_goes_by_all_the_physics_that_makes_it():
    """Every module of physics that the simulator or the training scenes import, or these do."""
    files = set()
    todo = [f for s in SOURCES for f in (s.rglob("*.py") if s.is_dir() else [s])]
    while todo:
        file = todo.pop()
        if file in files or file.suffix != ".py" or file.name == "__init__.py":
            continue
        files.add(file)
        for name in imports(file, everywhere=True):
            path = ROOT.joinpath(*name.split(".")).with_suffix(".py")
            if path.is_relative_to(ROOT / "physics") and path.exists():
                todo.append(path)
    held = {f for s in SOURCES for f in (s.rglob("*.py") if s.is_dir() else [s])}
    machinery = {
        f"physics/machinery/{name}.py" for name in ("provenance", "scratch", "threads", "tiles")
    }
    assert {f.relative_to(ROOT).as_posix() for f in files - held} <= machinery
