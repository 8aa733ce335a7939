"""The house keeps its shape: imports point down, each foreign library has one door, no room outgrows its name."""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "emran_sumo"
FLOORS = (
    "__init__ kernels units errors locate shipped controllers print_style garbage",
    "plant path",
    "control",
    "loop conditioning frames reference",
    "world recording metrics encounters maneuver scenario viewer vehicles vehicle_figure options found "
    "faults observation own_controller",
    "user_code ego handover takeover planner selection opening warm manifest stop results drive bench report tuning "
    "search checkpoint tune paper",
    "study compare export python",
    "terminal cli_study cli_vehicle cli_files cli",
)
FLOOR = {room: level for level, rooms in enumerate(FLOORS) for room in rooms.split()}
DOORS = {"libsumo": "world", "traci": "world", "sumolib": "world", "rerun": "recording", "numba": "kernels"}
DOORS |= {"sqlite3": "study", "dask": "study", "distributed": "study"}
LONGEST = 400  # lines; a longer module has a second idea inside
GRANTED: dict[Path, int] = {}  # none so far
FRONT = Path("__init__")  # names what lies above, and imports it only when asked for (test_own_controller.py)
MODULES = sorted(file.relative_to(PACKAGE).with_suffix("") for file in PACKAGE.rglob("*.py"))


def imports(module: Path) -> set[str]:
    """Dotted names of everything a module imports, also inside functions."""
    found = set()
    for node in ast.walk(ast.parse((PACKAGE / module).with_suffix(".py").read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module}: relative import"
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return found


@pytest.mark.parametrize("module", MODULES, ids=str)
def test_imports_point_down_and_foreign_libraries_have_one_door(module: Path):
    room = module.parts[0]
    assert room in FLOOR, f"{module}: on which floor is it?"
    for name in imports(module):
        top, *rest = name.split(".")
        assert DOORS.get(top, room) == room, f"{module} imports {name}, which is for {DOORS[top]} alone"
        if top == "emran_sumo" and module != FRONT:
            lower = rest[0] if rest[0] in FLOOR else "__init__"
            assert FLOOR[lower] <= FLOOR[room], f"{module} imports {name} from a floor above"


@pytest.mark.parametrize("module", MODULES, ids=str)
def test_no_module_is_longer_than_it_reads_well(module: Path):
    lines = len((PACKAGE / module).with_suffix(".py").read_text(encoding="utf-8").splitlines())
    assert lines <= GRANTED.get(module, LONGEST), f"{module}: {lines} lines"
