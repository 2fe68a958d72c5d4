"""The parts of a page: a verdict, and sections of text, tables and figures. Each is checked when it is created."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, final, get_args

from aleator._core.border import members, one_of, refusal

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

Level = Literal["good", "caution", "bad"]


@final
@dataclass(frozen=True)
class Verdict:
    """The first screen: a mark and its word, one headline, rows of facts, a few sentences.

    - `rows`: what is said of the proposed design, each with its name.
    """

    level: Level
    word: str
    headline: str
    sentences: Sequence[str] = ()
    rows: Sequence[tuple[str, str]] = ()

    def __post_init__(self) -> None:
        if self.level not in get_args(Level):
            raise refusal("Verdict: level", " or ".join(map(repr, get_args(Level))), self.level)
        _texts(self, "word", "headline")
        members("Verdict: sentences", self.sentences, str)


@final
@dataclass(frozen=True)
class Text:
    """Paragraphs of plain text; `lead` is set in bold before the first."""

    paragraphs: Sequence[str]
    lead: str = ""
    kind: str = "text"

    def __post_init__(self) -> None:
        members("Text: paragraphs", self.paragraphs, str)
        _texts(self, "lead")


@final
@dataclass(frozen=True)
class Code:
    """Text in a fixed-width font, such as a problem printed as mathematics, collapsed unless `opened`."""

    heading: str
    text: str
    opened: bool = False
    kind: str = "code"

    def __post_init__(self) -> None:
        _texts(self, "heading", "text")


@final
@dataclass(frozen=True)
class Table:
    """A table of text; the first column names the rows."""

    caption: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""
    kind: str = "table"

    def __post_init__(self) -> None:
        _texts(self, "caption", "note")
        members("Table: header", self.header, str)
        for i, row in enumerate(members(f"Table '{self.caption}': rows", self.rows, Sequence)):
            cells = members(f"Table '{self.caption}': row {i}", row, str)
            if len(cells) != len(self.header):
                raise refusal(f"Table '{self.caption}': row {i}", f"{len(self.header)} texts, one a column", row)


@final
@dataclass(frozen=True)
class Drawing:
    """One figure, or several in a row with a common heading and a caption that says what to see in it."""

    figures: "Sequence[Figure]"
    heading: str
    caption: str = ""
    number: str = ""
    kind: str = "drawing"

    def __post_init__(self) -> None:
        from plotly.graph_objects import Figure

        _texts(self, "heading", "caption", "number")
        members(f"Drawing '{self.heading}': figures", self.figures, Figure)


@final
@dataclass(frozen=True)
class Schematic:
    """Drawings of a system as SVG, with its mathematics beside them."""

    drawings: Sequence[str]
    heading: str
    caption: str = ""
    number: str = ""
    beside: Sequence[Code] = ()
    kind: str = "schematic"

    def __post_init__(self) -> None:
        _texts(self, "heading", "caption", "number")
        members(f"Schematic '{self.heading}': drawings", self.drawings, str)
        members(f"Schematic '{self.heading}': beside", self.beside, Code)

    def __html__(self) -> str:
        """The drawings as markup for the template; they are trusted, as the study is."""
        return "".join(f'<div class="sketch">{one}</div>' for one in self.drawings)


@final
@dataclass(frozen=True)
class Choice:
    """A design that a reader can choose on a page: its name, what is known of it in tables, and a figure of each of its
    paths, with the path's name in its `meta`.
    """

    name: str
    facts: Sequence[Table]
    bands: "Sequence[Figure]" = ()

    def __post_init__(self) -> None:
        from plotly.graph_objects import Figure

        _texts(self, "name")
        members(f"Choice '{self.name}': facts", self.facts, Table)
        members(f"Choice '{self.name}': bands", self.bands, Figure)


@final
@dataclass(frozen=True)
class Linked:
    """Figures of designs and a table of them, one row each, beside all that is known of the one that a reader chooses.

    - `figures`: a trace says by its `meta`, a list of places in `choices`, to which designs its points belong;
    - `table`: a row for each of `choices`, in the same order; without JavaScript it is what is shown;
    - `chosen`: the place of the one shown first.
    """

    figures: "Sequence[Figure]"
    heading: str
    table: Table
    choices: Sequence[Choice]
    chosen: int = 0
    caption: str = ""
    number: str = ""
    kind: str = "linked"

    def __post_init__(self) -> None:
        from plotly.graph_objects import Figure

        _texts(self, "heading", "caption", "number")
        members(f"Linked '{self.heading}': figures", self.figures, Figure)
        one_of(f"Linked '{self.heading}': table", self.table, Table)
        count = len(members(f"Linked '{self.heading}': choices", self.choices, Choice))
        if len(self.table.rows) != count:
            raise refusal(f"Linked '{self.heading}': table", f"{count} rows, one a choice", len(self.table.rows))
        if self.chosen not in range(count):
            raise refusal(f"Linked '{self.heading}': chosen", f"the place of one of {count} choices", self.chosen)


Block = Text | Code | Table | Drawing | Schematic | Linked


@final
@dataclass(frozen=True)
class Section:
    """A heading and the blocks under it, which a reader opens if they are `folded`."""

    heading: str
    blocks: Sequence[Block]
    folded: bool = False

    def __post_init__(self) -> None:
        _texts(self, "heading")
        members(f"Section '{self.heading}': blocks", self.blocks, get_args(Block))

    @property
    def anchor(self) -> str:
        """The heading as a link target."""
        return re.sub(r"[^a-z0-9]+", "-", self.heading.lower()).strip("-") or "section"


def _texts(block: Any, *fields: str) -> None:
    """Refuse fields of a block that are not text."""
    for field in fields:
        one_of(f"{type(block).__name__}: {field}", getattr(block, field), str)
