"""Finding a user's own controller by `module:factory` or `file.py:factory`, and the source files it is made of."""

import ast
import contextlib
import copy
import hashlib
import importlib
import importlib.util
import inspect
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from emran_sumo.controllers import is_own
from emran_sumo.errors import UserError, nearest_name
from emran_sumo.faults import ControllerFault, defined_at, failed_at, shown
from emran_sumo.own_controller import OwnController
from emran_sumo.scenario import Located

ACCEPTED = "module:factory or path/to/file.py:factory"
_loaded: dict[Path, str] = {}  # file -> digest of what was imported from it


class Maker(NamedTuple):
    """Makes one controller per ego. name: what the user calls it; make: called without arguments."""

    name: str
    make: Callable[[], Any]

    def __call__(self) -> OwnController:
        """A controller that has been reset.

        Raises:
            ControllerFault: the factory or reset() fails, or what it makes is no controller.
        """
        try:
            made = self.make()
        except (Exception, SystemExit) as error:
            inside = error.__traceback__ is not None and error.__traceback__.tb_next is not None
            where = failed_at(error) if inside else f"{defined_at(self.make)}{type(error).__name__}: {error}"
            raise ControllerFault(
                f"controller {self.name}: {where}; accepted is a factory that is called without arguments."
            ) from error
        return OwnController(made, self.name)


def maker(located: Located) -> Maker | None:
    """How the controllers of a scenario are made; None for a built-in one.

    Raises:
        UserError: there is no such module, file or name.
        ControllerFault: the module cannot be imported.
    """
    name = located.values.controller
    if not is_own(name):
        return None
    found = located.controller if located.controller is not None else _named(name, located.folder)
    if isinstance(found, type) or (callable(found) and not hasattr(found, "step")):
        return Maker(name, found)
    spare, first = copy.deepcopy(found), [found]
    return Maker(name, lambda: first.pop() if first else copy.deepcopy(spare))  # an object of its own for each ego


def sources(located: Located) -> dict[str, Path]:
    """Name -> file of an own controller's source: its module, and those of its folder that it imports.

    Raises:
        UserError: as for `maker`.
    """
    made = maker(located)
    if made is None:
        return {}
    name = located.values.controller
    module = _module(name, located.folder) if located.controller is None else sys.modules.get(_home(located.controller))
    first = getattr(module, "__file__", None)
    found: dict[str, Path] = {}
    waiting = [Path(first)] if first else []
    while waiting:
        file = waiting.pop().resolve()
        if file.suffix == ".py" and shown(str(file)) not in found:
            found[shown(str(file))] = file
            waiting += _beside(file)
    return found


def text_of(controller: Any) -> str:
    """`module:factory` of a class, a function or an object that Python was given.

    What a script defines is found by the script's file; what a notebook defines, only there.
    """
    of = controller if hasattr(controller, "__qualname__") else type(controller)
    module = _home(controller)
    file = getattr(sys.modules.get(module), "__file__", None) if module == "__main__" else None
    return f"{shown(file) if file else module}:{of.__qualname__}"


def _home(controller: Any) -> str:
    """Name of the module that defines it."""
    return getattr(controller, "__module__", None) or type(controller).__module__


def _named(text: str, folder: Path) -> Any:
    module, (_, _, path) = _module(text, folder), text.rpartition(":")
    found: Any = module
    for part in path.split("."):
        try:
            found = getattr(found, part)
        except AttributeError:
            file = shown(getattr(module, "__file__", None) or module.__name__)
            hint = nearest_name(part, [name for name in vars(found) if not name.startswith("_")])
            raise UserError(f'controller: found "{text}"; {file} has no "{part}". {hint}') from None
    return found


def _module(text: str, folder: Path) -> ModuleType:
    """The module of `module:factory`; a path is one from here, or from the folder of the scenario."""
    module, _, factory = text.rpartition(":")
    if not (module and factory):
        raise UserError(f'controller: found "{text}"; accepted is {ACCEPTED}.')
    try:
        return _from_file(text, Path(module), folder) if module.endswith(".py") else _by_name(text, module)
    except UserError:
        raise
    except (Exception, SystemExit) as error:  # of the user's code
        raise ControllerFault(f"controller {text}: {failed_at(error)}.") from error


def _by_name(text: str, name: str) -> ModuleType:
    here = str(Path.cwd())
    if here not in sys.path:  # as `python -m` has it
        sys.path.insert(0, here)
    importlib.invalidate_caches()
    try:
        module = importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name and (name == error.name or name.startswith(f"{error.name}.")):
            raise UserError(f'controller: found "{text}"; no module "{name}" here or installed.') from None
        raise
    file = getattr(module, "__file__", None)
    if file and _changed(Path(file)):
        module = importlib.reload(module)
    return module


def _from_file(text: str, given: Path, folder: Path) -> ModuleType:
    file = next((f for f in (given, folder / given) if f.is_file()), None)
    if file is None:
        raise UserError(f'controller: found "{text}"; no such file: {given}.')
    file = file.resolve()
    name = f"{file.stem}_{hashlib.sha256(str(file).encode()).hexdigest()[:8]}"  # files of one name do not meet
    if not _changed(file) and name in sys.modules:
        return sys.modules[name]
    if str(file.parent) not in sys.path:  # as Python has it for a script
        sys.path.insert(0, str(file.parent))
    spec = importlib.util.spec_from_file_location(name, file)
    assert spec is not None
    assert spec.loader is not None
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name], _loaded[file]
        raise
    return module


def _changed(file: Path) -> bool:
    """Whether a file is not what was imported from it before; from now on it is."""
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    before = _loaded.get(file)
    _loaded[file] = digest
    return before is not None and before != digest


def _beside(file: Path) -> list[Path]:
    """Files of the same folder that a module imports."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(file.read_bytes())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names |= {node.module or "", *(f"{node.module or ''}.{alias.name}".lstrip(".") for alias in node.names)}
    places = [file.parent / name.replace(".", "/") for name in names if name]
    candidates = [path for place in places for path in (place.with_suffix(".py"), place / "__init__.py")]
    return sorted(path for path in candidates if path.is_file())


def digests(located: Located) -> dict[str, str]:
    """Name -> digest of each source file of an own controller; of its class alone where a notebook defines it."""
    found = {name: hashlib.sha256(file.read_bytes()).hexdigest()[:16] for name, file in sources(located).items()}
    if not found and located.controller is not None:
        of = located.controller if hasattr(located.controller, "__qualname__") else type(located.controller)
        with contextlib.suppress(OSError, TypeError):
            found[located.values.controller] = hashlib.sha256(inspect.getsource(of).encode()).hexdigest()[:16]
    return found
