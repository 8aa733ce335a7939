"""Where in a user's own code something went wrong, in words."""

import inspect
import os
import sysconfig
import traceback
from pathlib import Path
from typing import Any

from emran_sumo.errors import UserError

_NOT_THEIRS = tuple(
    f"{folder}{os.sep}"
    for folder in (Path(__file__).parent, *(sysconfig.get_paths()[name] for name in ("stdlib", "purelib", "platlib")))
)


class ControllerFault(UserError):
    """A user's controller could not be made or asked; the cause is the exception of its code, where there is one."""


def failed_at(error: BaseException) -> str:
    """`file.py, line 3: ZeroDivisionError: division by zero` of an exception of the user's code."""
    if isinstance(error, SyntaxError) and error.filename:
        return f"{shown(error.filename)}, line {error.lineno}: {type(error).__name__}: {error.msg}"
    frames = [f for f in traceback.extract_tb(error.__traceback__) if not f.filename.startswith("<frozen")]
    theirs = [f for f in frames if not f.filename.startswith(_NOT_THEIRS)]
    said = " ".join(str(error).split())
    words = f"{type(error).__name__}: {said}" if said else type(error).__name__
    at = (theirs or frames)[-1:]
    return f"{shown(at[0].filename)}, line {at[0].lineno}: {words}" if at else words


def defined_at(thing: Any) -> str:
    """`file.py, line 3: ` of the definition of a function, a class, or an object's class; "" where it has none."""
    of = inspect.unwrap(getattr(thing, "__func__", thing))
    code = getattr(of, "__code__", None)
    if code is not None:
        return f"{shown(code.co_filename)}, line {code.co_firstlineno}: "
    of = of if inspect.isclass(of) else type(of)
    try:
        return f"{shown(inspect.getsourcefile(of) or '')}, line {inspect.getsourcelines(of)[1]}: "
    except (OSError, TypeError):
        return ""


def shown(file: str) -> str:
    """A file as seen from here, where it lies here."""
    try:
        return str(Path(file).resolve().relative_to(Path.cwd()))
    except (OSError, ValueError):
        return file
