"""The unit of a parameter, carried in its annotation so that every error message can name it."""

from typing import NamedTuple


class Unit(NamedTuple):
    """Unit of an annotated field, e.g. ``Annotated[float, Field(gt=0), Unit("kg")]``; "" where it has none."""

    symbol: str
