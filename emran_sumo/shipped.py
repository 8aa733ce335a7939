"""The scenarios that come with the package, without loading anything heavy."""

import tomllib

from emran_sumo import locate


def scenarios() -> dict[str, str]:
    """Name and title of every shipped scenario."""
    found = {}
    for file in sorted(locate.folder("scenarios").glob("*/scenario.toml")):
        with file.open("rb") as stream:
            found[file.parent.name] = str(tomllib.load(stream).get("title", ""))
    return found
