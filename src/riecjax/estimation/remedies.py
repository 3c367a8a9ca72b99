"""What to do where recordings do not tell of some parameters, or not of one by itself."""

from collections.abc import Sequence

from riecjax.equations.hidden_elements import is_mode_name, is_stiffness_name


def excite_or_hold(names: Sequence[str], hold: str = "") -> str:
    """A sentence on parameters that cannot be told apart.

    Parts of a hidden element are known together or not at all, and where nothing tells of them the
    likeliest reason is that there is none: it is left out rather than held.

    **Arguments:** `hold`, the one that is named to hold; by default none is.
    """
    hidden = [
        (any(map(is_mode_name, names)), "the hidden mode", "--add-mode"),
        (any(map(is_stiffness_name, names)), "the spring in series", "--add-spring"),
    ]
    found = [(what, option) for there, what, option in hidden if there]
    if found:
        what, options = (" and ".join(words) for words in zip(*found))
        return (
            f"Leave {what} out (on the command line: without {options}): the recordings may carry "
            f"none; if there is one, excite the system more richly."
        )
    if len(names) == 1:
        return (
            f"Excite it, or hold it at a known value (on the command line: --set {names[0]}=VALUE)."
        )
    return (
        f"Excite the system more richly, or hold one of them at a known value (on the command "
        f"line: --set {hold or 'NAME'}=VALUE)."
    )
