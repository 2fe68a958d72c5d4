"""The tree that the joints of a URDF make of its links."""

from collections.abc import Mapping
from pathlib import Path

from aleator.foreign._xml import Place, broken


def ordered(path: str | Path, links: Mapping[str, Place], joints: Mapping[str, Place]) -> tuple[str, dict[str, Place]]:
    """The first link, and the joints, those of parents before those of children.

    Raises `ProblemError` for links that do not exist, and for joints that make no tree with one root.
    """
    ends = {name: _ends(joint, links) for name, joint in joints.items()}
    carriers: dict[str, str] = {}
    for name, (_, child) in ends.items():
        if child in carriers:
            raise broken(
                path,
                f"link '{child}'",
                f"expected one joint that carries it; received '{carriers[child]}' and '{name}'. A tree has no loops: "
                "remove one joint, and close the loop by al.joints.Closure in a model of your own.",
            )
        carriers[child] = name
    roots = [name for name in links if name not in carriers]
    if len(roots) > 1:
        raise broken(
            path,
            "",
            f"expected one link that no joint carries, the root; received {roots}. Connect all but one of them by "
            "joints of the type fixed.",
        )
    found: dict[str, Place] = {}
    reached = set(roots)
    while following := [name for name, (parent, _) in ends.items() if parent in reached and name not in found]:
        found |= {name: joints[name] for name in following}
        reached |= {ends[name][1] for name in following}
    if len(found) < len(joints):
        circle = [name for name in links if name not in reached]
        raise broken(path, "", f"expected a tree of links; received a cycle: {circle} carry one another.")
    return roots[0], found


def _ends(joint: Place, links: Mapping[str, Place]) -> tuple[str, str]:
    """The links before and behind a joint."""
    parent, child = (joint.needed(end).text("link") for end in ("parent", "child"))
    for end, name in (("parent", parent), ("child", child)):
        if name not in links:
            raise broken(
                joint.path,
                joint.where,
                f"expected a link of the file as its {end}; received '{name}', which is none of {sorted(links)}."[:300],
            )
    return parent, child
