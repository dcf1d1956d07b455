"""The options of ``stcal fit --sequential``, and the filter that they describe."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from stcal.errors import InputError, UsageError

if TYPE_CHECKING:
    from stcal.calibration import Calibration
    from stcal.config import SensorConfig
    from stcal.pipeline.filter_run import FrameHistory
    from stcal.pipeline.filter_state import FilterState
    from stcal.pipeline.filtering import Variant
    from stcal.residuals import Residual

F = TypeVar("F", bound=Callable[..., Any])

_OPTIONS = (
    click.option(
        "--sequential",
        "method",
        type=click.Choice(["ekf", "sqrf", "ukf", "smoother"]),
        help="Fit frame by frame with this estimator.",
    ),
    click.option(
        "--no-rematch", is_flag=True, help="Identify stars with the initial calibration only."
    ),
    click.option(
        "--process-noise",
        default="none",
        show_default=True,
        help="Random walk in sigma per sqrt(hour): none, config, a number, or f_m=0.5,g_y=0.",
    ),
    click.option("--temperature", help="Parameters that may be linear in temperature, e.g. f_m."),
    click.option(
        "--precision",
        type=click.Choice(["double", "single"]),
        default="double",
        show_default=True,
        help="Arithmetic of the filter.",
    ),
    click.option("--no-shadow", is_flag=True, help="Do not fall back to the initial calibration."),
    click.option(
        "--state",
        type=click.Path(path_type=Path),
        help="state.json of an earlier run to go on from.",
    ),
)


@dataclass(frozen=True)
class FilterOptions:
    """What the command line says about the filter; ``method`` is None for a batch fit."""

    method: str | None
    no_rematch: bool
    process_noise: str
    temperature: str | None
    precision: str
    no_shadow: bool
    state: Path | None

    def check(self, batch: bool) -> None:
        """Refuse options that don't go together.

        Raises
        ------
        UsageError
        """
        plain = FilterOptions(None, False, "none", None, "double", False, None)
        if batch and self != plain:
            raise UsageError(
                "--no-rematch, --process-noise, --temperature, --precision, --no-shadow and "
                "--state belong to --sequential"
            )
        if self.method == "smoother" and self.state is not None:
            raise UsageError("smoother goes through all frames again: it has no --state")

    def variant(
        self,
        matches: str,
        names: tuple[str, ...] | None,
        residual: Residual,
        config: SensorConfig,
    ) -> Variant:
        """Return the filter that the options describe."""
        from stcal.pipeline.filtering import Variant

        return Variant(
            method=str(self.method),
            precision=self.precision,
            matches=matches,
            rematch=not self.no_rematch,
            process_noise=_process_noise(self.process_noise, names, config),
            parameters=names,
            temperature=tuple(t.strip() for t in (self.temperature or "").split(",") if t.strip()),
            shadow=not self.no_shadow,
            residual=residual,
        )

    def setting(
        self, variant: Variant, parent: Calibration, provenance: dict[str, Any]
    ) -> dict[str, Any]:
        """Return what must be the same for a run to go on from its state."""
        hashes = ("config_sha256", "catalogue_sha256", "parent_sha256")
        # As the file gives it back: lists for tuples.
        described: dict[str, Any] = json.loads(json.dumps(asdict(variant)))
        return (
            {"sensor_id": parent.sensor_id} | described | {key: provenance[key] for key in hashes}
        )

    def earlier(
        self, setting: dict[str, Any], history: str
    ) -> tuple[dict[str, FilterState] | None, dict[str, FrameHistory] | None]:
        """Return states and histories of the earlier run, None for a fresh start.

        Histories lie beside the state, named ``history`` (``<filter>-history`` for the others).
        """
        if self.state is None:
            return None, None
        from stcal.pipeline.filter_state import load_state
        from stcal.telemetry.history import read_history

        states = load_state(self.state, setting)
        names = {n: history if n == "constant" else f"{n}-{history}" for n in states}
        histories = {}
        for name, state in states.items():
            path = self.state.parent / names[name]
            histories[name] = read_history(path, len(state.x))
            if int(histories[name].frame_id[-1]) != state.last_frame_id:
                raise InputError(f"{path}: does not end with the frame that {self.state} ends with")
        return states, histories


def filter_options(function: F) -> F:
    """Give a command the options of a :class:`FilterOptions`."""

    @wraps(function)
    def command(
        method: str | None,
        no_rematch: bool,
        process_noise: str,
        temperature: str | None,
        precision: str,
        no_shadow: bool,
        state: Path | None,
        **others: Any,
    ) -> Any:
        given = FilterOptions(
            method, no_rematch, process_noise, temperature, precision, no_shadow, state
        )
        return function(filtering=given, **others)

    for option in reversed(_OPTIONS):
        command = option(command)
    return command  # type: ignore[return-value]


def _process_noise(
    text: str, estimated: tuple[str, ...] | None, config: SensorConfig
) -> dict[str, float]:
    """Return the random walk by parameter, empty for none.

    Raises
    ------
    UsageError
        Naming what is no parameter or no number.
    """
    from stcal.cameras import CAMERAS
    from stcal.pipeline.filtering import process_noise_of

    names = CAMERAS[config.camera.model].parameter_names
    if text == "none":
        return {}
    if text == "config":
        return process_noise_of(config, names)
    if "=" not in text:
        return dict.fromkeys(names, _number(text))
    found: dict[str, float] = {}
    for part in text.split(","):
        name, _, value = part.partition("=")
        if name.strip() not in names:
            raise UsageError(f"--process-noise: {name.strip()!r} is not one of {', '.join(names)}")
        if name.strip() in found:
            raise UsageError(f"--process-noise: {name.strip()} is given twice")
        if estimated is not None and name.strip() not in estimated:
            raise UsageError(f"--process-noise: {name.strip()} is held fixed")
        found[name.strip()] = _number(value)
    return found


def _number(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value < 1e6:
        raise UsageError(f"--process-noise: {text.strip()!r} is not a number from 0 up")
    return value
