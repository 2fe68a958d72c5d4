"""The group of all subcommands, whose refusals are JSON documents too where `--json` asks for one."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, cast, final

import typer
from typer.core import TyperGroup
from typing_extensions import override

from aleator.cli._terminal import USAGE, Terminal

_ASKED = "aleator.asked"

# Click's `UsageError`, which some versions of typer take from click, and others have within themselves.
_UsageError = cast(type[typer.BadParameter], typer.BadParameter.__mro__[1])


@final
class Commands(TyperGroup):
    """Subcommands. What typer itself refuses is told on stderr, and on stdout as a document."""

    @override
    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        ctx.meta[_ASKED] = asked = tuple(args)
        with _documented(asked):
            return super().parse_args(ctx, args)

    @override
    def invoke(self, ctx: Any) -> Any:
        with _documented(ctx.meta[_ASKED]):
            return super().invoke(ctx)


@contextmanager
def _documented(asked: Sequence[str]) -> Iterator[None]:
    try:
        yield
    except _UsageError as error:
        command = next((one for one in asked if not one.startswith("-")), "")
        Terminal(command, "--json" in asked).print_refusal(error.format_message(), USAGE)
        raise
