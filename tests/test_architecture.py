"""A package imports only those below it (ABOVE), and light modules stay light."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
HEAVY = {"torch", "kornia", "matplotlib", "sklearn", "numba", "trimesh", "embreex", "OpenEXR"}
ABOVE = {
    "physics": {"texnet", "training", "export", "benchmarks"},
    "texnet": {"training", "export", "benchmarks"},
    "training": {"benchmarks"},
    "export": {"benchmarks"},
    "benchmarks": set(),
}
COMMANDS = {ROOT / "texnet" / name for name in ("commands.py", "decompose_command.py")}  # see all
WITHIN = {
    "physics/machinery": {"errors"},
    "physics/cube": {"machinery", "errors", "planck", "bands", "sky"},
}
LIGHT = [
    "physics/__init__.py", "physics/errors.py", "physics/planck.py", "physics/cube/heat_cube.py",
    "physics/library.py", "physics/environment.py", "physics/machinery/whole_file.py",
    "physics/machinery/tiles.py", "texnet/by_tiles.py", "physics/hypotheses.py",
    "physics/known.py", "export/__init__.py", "texnet/runtime.py", "texnet/__init__.py",
    "texnet/cli.py", "texnet/commands.py", "texnet/decompose_command.py", "texnet/files/cube_io.py",
    "texnet/stretch.py", "texnet/progress.py", "texnet/report.py", "texnet/decomposition.py",
]  # fmt: skip


def imports(path, everywhere):
    """Absolute names of the modules that a file imports: anywhere, or at module level only."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    package = path.relative_to(ROOT).with_suffix("").parts[:-1]
    found = set()
    for node in ast.walk(tree) if everywhere else tree.body:
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            name = ".".join([*base, *([node.module] if node.module else [])])
            found |= {name, *(f"{name}.{alias.name}" for alias in node.names)}  # modules, perhaps
    return found


def tops(path, everywhere=True):
    return {name.split(".")[0] for name in imports(path, everywhere)}


def test_the_reader_of_imports_reads_relative_ones():
    found = imports(ROOT / "physics" / "simulator" / "scene.py", everywhere=True)
    assert {"physics.errors", "physics.sky", "numpy", "trimesh"} <= found


@pytest.mark.parametrize("layer", ABOVE)
def test_arrows_point_down(layer):
    sources = set((ROOT / layer).rglob("*.py")) - COMMANDS
    wrong = {str(p): tops(p) & ABOVE[layer] for p in sources if tops(p) & ABOVE[layer]}
    assert not wrong


@pytest.mark.parametrize("package", WITHIN)
def test_packages_within_stand_on_their_own(package):
    """They import nothing of the package around them but what is named."""
    around, own = package.split("/")
    names = {n for p in (ROOT / package).glob("*.py") for n in imports(p, everywhere=True)}
    paths = {tuple(n.split(".")[1:]) for n in names if n.startswith(f"{around}.")}
    there = {m.stem for m in (ROOT / around).glob("*.py")}
    there |= {m.parent.name for m in (ROOT / around).glob("*/__init__.py")}
    assert {p[0] for p in paths if p and p[0] in there} <= {own, *WITHIN[package]}


@pytest.mark.parametrize("file", LIGHT)
def test_light_modules_import_nothing_heavy_at_module_level(file):
    assert not tops(ROOT / file, everywhere=False) & HEAVY


def test_the_command_line_starts_without_anything_heavy():
    code = (
        "import sys, texnet, texnet.cli\n"
        "try: texnet.cli.main(['--help'])\n"
        "except SystemExit: pass\n"
        f"print('LOADED', sorted({HEAVY!r} & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert "decompose" in done.stdout and done.stdout.endswith("LOADED []\n")


def test_texnet_offers_the_pipeline_lazily():
    code = (
        "import sys, texnet\n"
        "assert 'torch' not in sys.modules\n"
        "assert set(texnet.__all__) < set(dir(texnet))\n"
        "from texnet import *\n"
        "assert decompose is texnet.decompose and callable(read_cube)\n"
        "import physics\n"
        "assert all(getattr(texnet, n) is getattr(physics, n) for n in physics.__all__)\n"
        "assert not hasattr(texnet, 'no_such_name')\n"
        "assert texnet.__version__[0].isdigit()\n"
    )
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)


@pytest.mark.parametrize(
    "map_", [str(p.relative_to(ROOT)) for a in ABOVE for p in (ROOT / a).rglob("__init__.py")]
)
def test_a_package_s_map_names_all_its_modules(map_):
    folder = (ROOT / map_).parent
    there = {p.stem for p in folder.glob("*.py")} - {"__init__"}
    there |= {p.parent.name for p in folder.glob("*/__init__.py")}
    text = ast.get_docstring(ast.parse((ROOT / map_).read_text("utf-8")))
    rows = text.partition("The map:")[2] or text
    assert {name for name in there if not re.search(rf"\b{name}\b", rows)} == set()


def test_scenes_and_files_never_unpickle():
    for layer in ABOVE:
        for path in (ROOT / layer).rglob("*.py"):
            assert "pickle" not in tops(path), path
            assert "allow_pickle=True" not in path.read_text(encoding="utf-8"), path
