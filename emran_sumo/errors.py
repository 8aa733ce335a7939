"""A user's mistake, told in one sentence."""

LISTED = 24  # names that a sentence lists at the most


class UserError(Exception):
    """What was found where, and what is accepted; the command line prints it and exits with code 2."""


class Interrupted(BaseException):
    """A signal came before a run began to drive; its number is the argument."""


def nearest_name(name: str, known: list[str], listed: str = "") -> str:
    """`Did you mean "..."?` for a misspelled name, or else the known ones, or `listed` in their place."""
    import difflib

    close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    if close:
        return f'Did you mean "{close[0]}"?'
    more = f" and {len(known) - LISTED} more" if len(known) > LISTED else ""
    return f"Known: {listed or ', '.join(sorted(known)[:LISTED]) + more}."
