"""Encoder of a Yamcs command stack: the JSON that Yamcs web and its stack activities run."""

from __future__ import annotations

import json
from typing import Any

from stcal.calibration import Calibration
from stcal.uplink.formats.words import layout, words
from stcal.uplink.target import Target
from stcal.uplink.target_sections import YamcsCommand, YamcsSection

_SCHEMA = "https://yamcs.org/schema/command-stack.schema.json"
# Yamcs web reads numbers as doubles.
_EXACT = 2**53


def encode(section: YamcsSection, calibration: Calibration, target: Target) -> dict[str, bytes]:
    """Return the command stack by its file name."""
    commands = [
        _command(command, section.instance, calibration, target) for command in section.commands
    ]
    stack = {"$schema": _SCHEMA, "commands": commands}
    return {section.file: (json.dumps(stack, indent=2, allow_nan=False) + "\n").encode("ascii")}


def _command(
    command: YamcsCommand, instance: str, calibration: Calibration, target: Target
) -> dict[str, Any]:
    arguments = [{"name": k, "value": v} for k, v in command.arguments.items()]
    comment = command.comment
    if command.calibration:
        arguments += _arguments(command, calibration, target)
        comment = _comment(command, instance, calibration)
    advancement = {"acknowledgment": command.acknowledgment, "wait": command.wait_ms}
    advancement = {k: v for k, v in advancement.items() if v is not None}
    return {
        "name": command.name,
        **({"comment": comment} if comment else {}),
        "extraOptions": [],
        "arguments": arguments,
        **({"advancement": advancement} if advancement else {}),
    }


def _arguments(
    command: YamcsCommand, calibration: Calibration, target: Target
) -> list[dict[str, Any]]:
    numbers = {k: _argument(v) for k, v in words(calibration, target).items()}
    if command.argument is None:
        return [{"name": k, "value": v} for k, v in numbers.items()]
    members: dict[str, Any] = {}
    for slot in layout(target)[0]:
        if slot.label == slot.field.name:
            members[slot.label] = numbers[slot.label]
        else:
            members.setdefault(slot.field.name, []).append(numbers[slot.label])
    return [{"name": command.argument, "value": members}]


def _comment(command: YamcsCommand, instance: str, calibration: Calibration) -> str:
    what = f"{calibration.sensor_id} serial {calibration.serial}, instance {instance}"
    return f"{what}: {command.comment}" if command.comment else what


def _argument(number: float | int) -> float | int | str:
    return str(number) if isinstance(number, int) and abs(number) > _EXACT else number
