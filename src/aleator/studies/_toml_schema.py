"""What a study file may say, as pydantic models; their JSON Schema lets editors complete it."""

from typing import Annotated, Any, Literal, TypeAlias

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag

from aleator.reporting import TARGET

# Texts and truth values are no numbers.
Real: TypeAlias = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Truth: TypeAlias = Annotated[bool, Field(strict=True)]
Quantity: TypeAlias = Annotated[
    Real | Annotated[str, Field(strict=True)],
    Field(description='A number in the unit of the model, or with its own: "30 kN/m".'),
]
Whole: TypeAlias = Annotated[int, Field(strict=True)]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=False)


class DecisionTable(_Table):
    """A number that is decided: `{ start = "30 kN/m", lower = "20 kN/m", upper = "90 kN/m" }`."""

    start: Quantity
    lower: Quantity | None = None
    upper: Quantity | None = None


def _kind(value: Any) -> str:
    """What a value of the model is meant to be, so that errors speak of that alone."""
    if isinstance(value, dict):
        return "<distribution>" if "distribution" in value else "<decision>"
    return "<quantity>"


_NUMBERS = Annotated[DecisionTable, Tag("<decision>")] | Annotated[Quantity, Tag("<quantity>")]


class DistributionTable(BaseModel):
    """A number that is uncertain: `{ distribution = "Uniform", mean = "2 kg", half_width = "0.1 kg" }`."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Annotated[_NUMBERS, Discriminator(_kind)]]  # pyright: ignore
    distribution: Literal[
        "Uniform",
        "Normal",
        "Beta",
        "Gamma",
        "LogNormal",
        "Triangular",
        "TruncatedNormal",
        "Toleranced",
        "Exponential",
        "Gumbel",
        "Weibull",
    ]


class GridTable(_Table):
    """Another grid: `t_final`, `steps`, or both."""

    t_final: Quantity | None = None
    steps: Annotated[Whole, Field(ge=1, le=10_000_000)] | None = None


class ExpansionTable(_Table):
    """Another order of the expansion."""

    order: Annotated[Whole, Field(ge=0, le=50)]


class SolverTable(BaseModel):
    """A solver by its name, with its options."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[str, Truth | Whole | Real]  # pyright: ignore
    name: Literal[
        "FilterSQP",
        "Ipopt",
        "Slsqp",
        "InteriorPoint",
        "NelderMead",
        "Direct",
        "DifferentialEvolution",
        "DualAnnealing",
        "CmaEs",
    ]


_VALUE = Annotated[_NUMBERS | Annotated[DistributionTable, Tag("<distribution>")], Discriminator(_kind)]


class StudyFile(_Table):
    """A study: a problem by the name of its module, and what is different from it."""

    problem: Annotated[str, Field(description="The problem, or a function that makes it: `package.module:name`.")]
    title: str = ""
    subtitle: str = ""
    samples: Annotated[Whole, Field(ge=2, le=10_000_000_000)] = 20_000
    seed: Annotated[Whole, Field(ge=0)] = 0
    target: Annotated[Real, Field(gt=0, lt=1, description="The largest share of systems that may break a limit.")] = (
        TARGET
    )
    workers: Annotated[Whole, Field(ge=1, le=10_000)] | None = None
    deterministic: Annotated[Truth, Field(description="Solve the problem at the means too, for comparison.")] = False
    model: Annotated[
        dict[str, _VALUE], Field(description="Numbers, distributions and decisions by the names of the model's fields.")
    ] = {}
    limits: Annotated[
        dict[str, Quantity | tuple[Quantity, Quantity]], Field(description="Bounds by the names of constraints.")
    ] = {}
    sigmas: Annotated[
        dict[str, Annotated[Real, Field(gt=0)]], Field(description="Margins by the names of constraints.")
    ] = {}
    sweeps: Annotated[
        dict[str, Annotated[list[Quantity], Field(min_length=1)]], Field(description="Values of bounds for fronts.")
    ] = {}
    grid: GridTable | None = None
    expansion: ExpansionTable | None = None
    solver: SolverTable | None = None
