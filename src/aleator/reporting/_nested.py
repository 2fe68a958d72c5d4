"""Results that are nested in mappings, as studies return them."""

from collections.abc import Iterator, Mapping
from typing import Any


def leaves(results: Mapping[str, Any], *outer: str) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Each result with the names under which it stands, the outermost first."""
    for name, one in results.items():
        if isinstance(one, Mapping):
            yield from leaves(one, *outer, str(name))
        else:
            yield (*outer, str(name)), one


def by_place(results: Mapping[str, Any]) -> dict[str, Any]:
    """Each result by its place, such as `designs/robust`."""
    return {"/".join(names): one for names, one in leaves(results)}
