"""Systems in words."""

from collections.abc import Mapping

# Messages list at most this many numbers.
_MOST_NUMBERS = 5


def system_text(numbers: Mapping[str, float]) -> str:
    """A system by its uncertain numbers, the first few if there are many."""
    shown = [f"{name} = {number:.6g}" for name, number in numbers.items()]
    left = len(shown) - _MOST_NUMBERS
    return ", ".join(shown[:_MOST_NUMBERS]) + (f" and {left} more" if left > 0 else "")
