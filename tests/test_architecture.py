"""The house: which package may import which, sizes of files, and public names."""

import ast
import importlib
import pkgutil
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from study_helpers import made_up_study, write

import jaxreplay as jr
from jaxreplay.errors import ConfigError

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "jaxreplay"
SOURCES = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
    for path in sorted(PACKAGE.rglob("*.py"))
}

# What each part may import besides itself. Data runs downward: records → filter → loop → recordings
# and study → figures → cli, with the plane joining in the study.
GROUND = {"errors", "machine"}
MAY_IMPORT = {
    "errors": set(),
    "machine": {"errors"},
    "params": GROUND,
    "reference": set(),
    "records": {"machine"},
    "filter": {"records", "params"},
    "loop": GROUND | {"records", "params", "filter"},
    "plane": {"errors"},
    "recordings": GROUND | {"records", "params", "filter", "loop"},
    "study": GROUND | {"records", "params", "filter", "loop", "plane", "recordings"},
    "page": {"records", "plane", "study.dataset", "figures"},
    "explore": GROUND | {"records", "plane", "loop", "study", "figures", "page"},
    "pictures": {"errors", "records", "recordings", "study", "figures", "page"},
    "figures": {"records", "params", "plane", "recordings", "study.dataset"},
    "cli": GROUND | {"params", "records", "recordings", "study", "figures", "pictures", "explore"},
    "": {
        "filter",
        "loop",
        "plane",
        "params",
        "records",
        "recordings",
        "study",
        "pictures",
    },  # the public names
    "__main__": {"cli"},
}


def imports_of(name):
    """All modules of the package that a module imports, at whatever place."""
    found = set()
    for node in ast.walk(ast.parse(SOURCES[name].read_text())):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name} has a relative import"
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        else:
            continue
        for imported in names:
            parts = imported.split(".")
            while parts and ".".join(parts) not in SOURCES:  # a name in a module
                parts.pop()
            if parts and parts[0] == "jaxreplay":
                found.add(".".join(parts))
    return found - {name}


IMPORTS = {name: imports_of(name) for name in SOURCES}


def within(module, places):
    """Whether a module is in one of the places, such as `filter` or `study.dataset`."""
    path = module.removeprefix("jaxreplay").removeprefix(".")
    return any(path == place or path.startswith(f"{place}.") for place in places if place)


def part_of(module):
    return [*module.split("."), ""][1]


@pytest.mark.parametrize("name", SOURCES)
def test_every_import_goes_down(name):
    part = part_of(name)
    wrong = sorted(m for m in IMPORTS[name] if not within(m, MAY_IMPORT[part] | {part}))
    assert not wrong, f"{name} imports {', '.join(wrong)}"


def test_no_circle():
    """The public names, loaded on first use, are not counted."""
    graph = {name: IMPORTS[name] - {"jaxreplay"} for name in SOURCES if name != "jaxreplay"}
    while leaves := [name for name, imported in graph.items() if not imported & graph.keys()]:
        for name in leaves:
            del graph[name]
    assert not graph


def test_the_reference_needs_no_jax():
    tree = ast.parse(SOURCES["jaxreplay.reference"].read_text())
    assert not any("jax" in ast.unparse(n) for n in ast.walk(tree) if isinstance(n, ast.Import))
    assert not IMPORTS["jaxreplay.reference"]


def test_files_have_one_subject_each():
    assert len(list(PACKAGE.glob("*.py"))) <= 8
    every = [p for top in ("jaxreplay", "tests", "experiments") for p in (ROOT / top).rglob("*.py")]
    long = {p.name: n for p in every if (n := len(p.read_text().splitlines())) > 330}
    assert not long


def test_no_public_name_is_that_of_a_package():
    """Importing a package would set an attribute of its name in place of the function."""
    assert not {name for name in jr.__all__ if f"jaxreplay.{name}" in SOURCES}
    assert set(jr.__all__) <= set(dir(jr))
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        jr.nothing  # noqa: B018


def call_each(folder):
    """Call every public function and class once."""
    rows = np.linspace(0, 1, 12)[:, None]
    records = jr.Records.from_sequences([rows, rows**2], [rows, -rows])
    params = jr.Params(0.1, 0.05, [0.1])
    called = {"Records": records, "Params": params}
    called["build_filter"] = filter = jr.build_filter()
    called["Filter"] = jr.Filter(*filter)
    belief = filter.init(records)
    called["Belief"] = jr.Belief(belief.p, belief.start, belief.dropped, belief.jump, belief.window)
    called["log_evidence"] = jr.log_evidence(records, params, rows)
    called["Replayer"] = jr.Replayer(records, params)
    env = gymnasium.make_vec(
        "Pendulum-v1", vectorization_mode="sync", max_episode_steps=2,
        vector_kwargs={"autoreset_mode": AutoresetMode.DISABLED},
    )  # fmt: skip
    seen = jr.Records.from_sequences([np.zeros((12, 3))], [np.zeros((12, 1))])
    batch = jr.Params([0.1], [0.05], [[1.0, 1.0, 1.0]])
    called["replay"] = jr.replay(seen, batch, env, [0])
    with pytest.raises(FileNotFoundError):
        called["open_study"] = jr.open_study(folder)
    called["PlaneParams"] = jr.PlaneParams()
    called["StudyConfig"] = config = jr.StudyConfig({"theta_i": [0.1]})
    file = write(folder, "theta_i = 0.1")
    if not (folder / "study").exists():
        made_up_study(file, folder / "study")
    called["load_config"] = jr.load_config(file)
    with pytest.raises(NotADirectoryError):
        called["run_study"] = jr.run_study(config, file)  # not a folder
    called["inspect"] = jr.inspect(records)
    records.save(folder / "records.npz")
    called["read"] = jr.read(folder / "records.npz")
    with pytest.raises(ValueError, match="no command ever changes"):
        called["tune"] = jr.tune(seen)
    called["plot"] = jr.plot(folder / "study")
    called["plot_map"] = jr.plot_map(jr.open_study(folder / "study"))
    called["plot_records"] = jr.plot_records(records)
    with pytest.raises(ConfigError, match="15 runs"):
        called["watch"] = jr.watch(folder / "study", 15)
    assert called["plot"]._repr_png_().startswith(b"\x89PNG")
    return {*called, "open_study", "run_study", "tune", "watch"}


def test_public_names_can_be_called_after_any_import(tmp_path):
    assert call_each(tmp_path) == set(jr.__all__)
    for module in pkgutil.walk_packages(jr.__path__, "jaxreplay."):
        if module.name != "jaxreplay.__main__":
            importlib.import_module(module.name)
    assert call_each(tmp_path) == set(jr.__all__)
