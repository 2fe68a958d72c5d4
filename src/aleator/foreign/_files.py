"""Files of robots as XML, and the sentences for those that are broken."""

from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

from aleator._core.errors import ProblemError

_READERS = {"robot": "al.foreign.read_urdf", "mujoco": "al.foreign.read_mjcf"}


def broken(path: Any, where: str, what: str) -> ProblemError:
    """The error that names a file, an element in it, and what is wrong there."""
    return ProblemError(f"{path}, {where}: {what}" if where else f"{path}: {what}")


def root_of(reader: str, path: Any, outermost: str) -> Element:
    """The outermost element of a file. Raises `ProblemError` where it cannot be read, or has another name."""
    try:
        root = _parsed(Path(path).read_bytes())
    except TypeError as error:
        raise ProblemError(f"{reader}: expected the path of a file; received {path!r}.") from error
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise broken(path, "", f"expected a file that can be read; received: {reason}.") from error
    except expat.ExpatError as error:
        raise broken(path, "", f"expected XML; received what is none: {error}.") from error
    if root.tag != outermost:
        other = f" Read it by {_READERS[root.tag]}." if root.tag in _READERS else ""
        raise broken(path, "", f"expected <{outermost}> as the outermost element; received <{root.tag}>.{other}")
    return root


def _parsed(text: bytes) -> Element:
    """XML without namespaces: robots' files use prefixes, such as those of other programs, that they do not declare."""
    builder, parser = TreeBuilder(), expat.ParserCreate()
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.data
    parser.Parse(text, True)
    return builder.close()
