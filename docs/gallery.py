"""The gallery of the site: runs the examples and the studies, draws a picture of each, and writes the page.

    python docs/gallery.py            # everything: about half an hour
    python docs/gallery.py clutch     # one picture, and the page

Pictures are written by Plotly and a Chromium (`python -m pip install 'aleator[paper]'`); the studies are run as by
`--quick`.
"""

import os
import re
import runpy
import sys
import tempfile
import types
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import aleator as al
from aleator.reporting import Drawing, Linked
from aleator.studies import Draft, load

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

DOCS = Path(__file__).parent
FIRST = "landing"
PICTURES, EXAMPLES = DOCS / "pictures", DOCS.parent / "examples"


class Entry(NamedTuple):
    """What the gallery tells of an example or a study: a heading, two sentences, and how its picture is drawn."""

    heading: str
    told: str
    shows: str
    draw: Callable[[], "Figure"]


def example(name: str) -> dict[str, Any]:
    """What an example has computed, by its names, in a folder that is thrown away."""
    here = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            return runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
        finally:
            os.chdir(here)


def solved(name: str) -> Any:
    """The figures of an example's solution."""
    return example(name)["solution"].plot


def called(name: str) -> Any:
    """What the function `main` of an example returns, which starts processes and so is imported by its name."""
    sys.path.insert(0, str(EXAMPLES))
    here = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            return __import__(name).main()
        finally:
            os.chdir(here)
            sys.path.remove(str(EXAMPLES))


def first() -> "Figure":
    """The figure of the first program on the front page."""
    text = (DOCS.parent / "README.md").read_text(encoding="utf-8")
    *program, _ = text.split("```python\n")[1].split("```")[0].splitlines()
    names: dict[str, Any] = {"__name__": FIRST}
    sys.modules[FIRST] = types.ModuleType(FIRST)
    exec("\n".join(program), names)
    return al.validate(al.solve(names["problem"])).plot()


def study(name: str, heading: str, which: int = 0) -> "Figure":
    """A figure of a study's page, under the last such heading, after a quick run."""
    page = Draft(load(name, quick=True))
    page.fill()
    blocks = [block for section in page.page().sections for block in section.blocks]
    *_, drawing = (block for block in blocks if isinstance(block, Drawing | Linked) and block.heading == heading)
    return drawing.figures[which]


EVERY: dict[str, dict[str, Entry]] = {
    "Examples": {
        "sources_of_uncertainty": Entry(
            "A drawer and its damper",
            "A drawer closes against a damper; its load, the push of the hand and the damper vary. What is the widest "
            "tolerance of the damper for which the drawer still ends in the right place?",
            "The distance closed of 20 000 drawers, and its limits.",
            lambda: al.validate(example("sources_of_uncertainty")["solution"], 20_000).plot.density(),
        ),
        "five_sources": Entry(
            "A heated stage with five sources of uncertainty",
            "A parameter, a first temperature and three random processes act together. How noisy may the thermometer "
            "be?",
            "The heater's power: mean, two standard deviations, limits.",
            lambda: solved("five_sources").band("power"),
        ),
        "co_design": Entry(
            "An arm, its counterweight, its motion and a tolerance",
            "All are designed together. The torque keeps its limits in the worst case.",
            "The torque for random payloads, between its limits.",
            lambda: solved("co_design").histories("angle_torque", samples=25),
        ),
        "ride_travel_holding": Entry(
            "Ride, travel and holding of a car",
            "What three wishes for a car's suspension cost one another.",
            "Certified designs, none better than another in all three wishes.",
            lambda: called("ride_travel_holding")[0].plot.curve(),
        ),
        "from_sympy": Entry(
            "A crane from SymPy",
            "The equations come from `LagrangesMethod`. The load is as still as possible at the end.",
            "The force for random ropes and loads, between its limits.",
            lambda: solved("from_sympy").histories("force", samples=25),
        ),
        "robot_from_file": Entry(
            "A robot from a URDF file",
            "The counterweight and the fastest motion of an arm are decided together, for all payloads.",
            "The shoulder's torque: its mean and the band of all payloads, between its limits.",
            lambda: solved("robot_from_file").band("shoulder_torque"),
        ),
        "black_box": Entry(
            "A simulator that is not ours",
            "A pendulum integrated by SciPy: samples run in processes and are kept in a journal.",
            "How much of the variance of the period each uncertain number causes.",
            lambda: called("black_box").plot.sensitivities("period"),
        ),
    },
    "Studies": {
        "suspension": Entry(
            "Suspension of a car",
            "A quarter car with five uncertain numbers, designed for the mean car, robustly, and with spreads "
            "apportioned at minimum cost: chapters 6 and 7 of the dissertation.",
            "The best ride over the travel allowed, for the mean car (dOpt) and for all cars (uOpt).",
            lambda: study("suspension", "Ride against the travel limit, H = 0.034 m"),
        ),
        "clutch": Entry(
            "Tolerances of a one-way clutch",
            "The pressure angle of a closed vector loop by expansion, linearisation and sampling, against its exact "
            "value; and the cheapest tolerances for a share of rejects.",
            "The distribution of the angle, its limits and rejects.",
            lambda: study("clutch", "Distribution of the angle, limits and rejects", 1),
        ),
        "pick-and-place-effort": Entry(
            "Pick and place with least effort",
            "Torques of a two-link arm for uncertain payloads, past an obstacle (forward dynamics). A second plan "
            "spends more effort for a smaller spread at the end.",
            "Paths of the tip for random payloads; those that touch obstacle or wall stand out.",
            lambda: study("pick-and-place-effort", "Path of the tip", 1),
        ),
        "pick-and-place-time": Entry(
            "Pick and place in least time",
            "The same arm follows a motion exactly, and its torques vary with the payload (inverse dynamics). For "
            "which margin does no payload overload a joint?",
            "Both torques for all payloads, between their limits.",
            lambda: study("pick-and-place-time", "Torques, robust, a = √3"),
        ),
        "swing-up": Entry(
            "Swing-up of a double pendulum",
            "One motor swings up two links whose second mass is uncertain (hybrid dynamics). The mean ends upright, "
            "and the spread of the tip is bounded.",
            "The motor's torque for 200 pendulums: mean, standard deviation and range.",
            lambda: study("swing-up", "Torques, robust, expected torque"),
        ),
        "four-bar": Entry(
            "A straight-line linkage",
            "Lengths, tolerances and clearances of Hoeken's linkage, at the lowest cost for which all but a few keep "
            "the tool in its zone.",
            "The tool's deviation from the line, of random linkages of the apportioned design (aOpt).",
            lambda: study("four-bar", "Deviation from the line", 3),
        ),
    },
}


def page() -> str:
    """The page, as Markdown."""
    parts = [
        "# Gallery",
        "",
        "Examples are run by `python examples/NAME.py`, studies by `aleator run NAME`, which writes a report.",
    ]
    for chapter, entries in EVERY.items():
        parts += ["", f"## {chapter}"]
        for name, one in entries.items():
            parts += ["", f"### {one.heading}", "", f"![](pictures/{name}.svg)", ""]  # the caption describes it
            parts += [one.told, "", f"*{one.shows}* {_source(chapter, name)}"]
    return "\n".join(parts) + "\n"


def _source(chapter: str, name: str) -> str:
    if chapter == "Examples":
        return f"[`examples/{name}.py`](../examples/{name}.py)"
    package = f"src/aleator/studies/{name.replace('-', '_')}"
    return f"[`aleator run {name}`](../{package}/__init__.py)"


def write_picture(draw: Callable[[], "Figure"], path: Path) -> None:
    """A picture that is the same whenever it is made: Plotly names clips and traces by numbers of chance."""
    picture = draw().to_image("svg", width=420, height=320).decode()
    for number in re.findall(r'<defs id="defs-(\w+)"', picture):
        picture = picture.replace(number, "aleator")
    path.write_text(re.sub(r" trace\w{6}\b", "", picture), encoding="utf-8")


def main(names: Sequence[str]) -> None:
    """Draw the pictures of these names, or all, and write the page."""
    drawn = {FIRST: first} | {name: one.draw for entries in EVERY.values() for name, one in entries.items()}
    for name in names or drawn:
        print(name, flush=True)
        write_picture(drawn[name], PICTURES / f"{name}.svg")
    (DOCS / "gallery.md").write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
