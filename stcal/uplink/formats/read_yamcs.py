"""Decoder of a Yamcs command stack, as Yamcs reads it; shares no code with the encoder."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

from stcal.uplink.decode import DecodeError


@dataclass(frozen=True)
class StackedCommand:
    """One command: name, comment, arguments in their order, and how the stack goes on."""

    name: str
    comment: str | None
    arguments: list[tuple[str, Any]]
    acknowledgment: str | None
    wait_ms: int | None


def read_stack(content: bytes) -> list[StackedCommand]:
    """Return the commands of a stack.

    Raises
    ------
    DecodeError
        When it is not a command stack.
    """
    try:
        document = json.loads(content, parse_constant=_refuse, object_pairs_hook=_unique)
        if set(document) != {"$schema", "commands"} or not document["$schema"].endswith(
            "yamcs.org/schema/command-stack.schema.json"
        ):
            raise ValueError("not a command stack")
        return [_command(command) for command in document["commands"]]
    except (KeyError, TypeError, ValueError, AttributeError, RecursionError) as error:
        raise DecodeError(f"Yamcs command stack cannot be decoded: {error!r}") from None


def _command(document: dict[str, Any]) -> StackedCommand:
    known = {"name", "comment", "extraOptions", "arguments", "advancement"}
    if set(document) - known or document["extraOptions"] != []:
        raise ValueError(f"unexpected members of {document['name']}")
    arguments = []
    for argument in document["arguments"]:
        if set(argument) != {"name", "value"}:
            raise ValueError(f"unexpected members of an argument of {document['name']}")
        arguments.append((argument["name"], argument["value"]))
    if not isinstance(document.get("comment", ""), str):
        raise ValueError(f"the comment of {document['name']} is not text")
    advancement = document.get("advancement", {})
    if set(advancement) - {"acknowledgment", "wait"}:
        raise ValueError(f"unexpected members of the advancement of {document['name']}")
    return StackedCommand(
        document["name"], document.get("comment"), arguments,
        advancement.get("acknowledgment"), advancement.get("wait"),
    )  # fmt: skip


def number_of_argument(value: Any) -> float | int:
    """Return the number of an argument; whole numbers beyond 2^53 come as text.

    Raises
    ------
    DecodeError
        When it is none.
    """
    if isinstance(value, str):
        try:
            number = int(value)
        except ValueError:
            raise DecodeError(f"Yamcs command stack: {value!r} is not a number") from None
        if str(number) != value or abs(number) <= 1 << 53:
            raise DecodeError(f"Yamcs command stack: {value!r} should not be text")
        return number
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise DecodeError(f"Yamcs command stack: {value!r} is not a number")
    return value


def _refuse(name: str) -> float:
    raise ValueError(f"{name} is not JSON")


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    result = dict(pairs)
    if len(result) != len(pairs):
        raise ValueError("a member occurs twice")
    return result
