"""Range checks of the values of a config, each refused in the same words."""

from __future__ import annotations

from collections.abc import Collection

from grabnet.errors import UserError


def at_least(config: object, where: str = "", /, **least: float) -> None:
    """Refuse the first value that is below its least one.

    Args:
        config: its attributes are the values; None, which stands for a default, passes.
        where: the config's place on the command line, as in "filter.".
        least: smallest value of each attribute, by name.

    Raises:
        UserError: "n is 0; it must be at least 1."
    """
    for name, low in least.items():
        value = getattr(config, name)
        if value is not None and not value >= low:  # not "<", which NaN passes
            raise UserError(f"{where}{name} is {value}; it must be at least {low}.")


def positive(config: object, *names: str) -> None:
    """Refuse the first of these values that is not above 0.

    Raises:
        UserError: "contact_distance is 0; it must be above 0."
    """
    for name in names:
        if not getattr(config, name) > 0:
            raise UserError(f"{name} is {getattr(config, name)}; it must be above 0.")


def one_of(config: object, where: str = "", /, **options: Collection[object]) -> None:
    """Refuse the first value that is none of its options.

    Args:
        config, where: as in `at_least`.
        options: values that each attribute can have, by name; None among them is printed as null.

    Raises:
        UserError: "hand is 'x'; it can be right, left."
    """
    for name, allowed in options.items():
        if (value := getattr(config, name)) not in allowed:
            listed = ", ".join("null" if option is None else str(option) for option in allowed)
            raise UserError(f"{where}{name} is {value!r}; it can be {listed}.")
