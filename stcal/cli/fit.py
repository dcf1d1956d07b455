"""``stcal fit``: refit the camera from stored telemetry, at once or frame by frame."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from stcal.cli.filter_options import FilterOptions, filter_options
from stcal.cli.inputs import OUT, Inputs, Selection, Workforce, read_inputs, store_options
from stcal.cli.output import conclude, progress, watched, write_documents
from stcal.cli.paths import own_folder

if TYPE_CHECKING:
    from rich.console import Console

    from stcal.calibration import Calibration
    from stcal.execution import OrderedMap
    from stcal.residuals import Residual

FITTED, DOCUMENT, REPORT = "calibration.json", "fit.json", "report.html"
STATE, HISTORY = "state.json", "history.parquet"


@click.command(name="fit")
@click.option("--batch", is_flag=True, help="Fit all frames at once, in cycles of rematching.")
@filter_options
@click.option(
    "--initial",
    required=True,
    type=click.Path(path_type=Path),
    help="Calibration to start from: the one on board.",
)
@click.option(
    "--matches",
    type=click.Choice(["telemetry", "lost-in-space", "guided"]),
    default="lost-in-space",
    show_default=True,
    help="Where the star matches come from (batch: those of the first cycle).",
)
@click.option("--parameters", help="Parameters to estimate, e.g. f_m,m0_px,n0_px; all by default.")
@click.option(
    "--residual",
    "residual_name",
    type=click.Choice(["arclength", "direction", "singular-values", "cosine"]),
    default="arclength",
    show_default=True,
    help="What the camera is fitted to.",
)
@click.option("--groups", type=int, help="Star groups of singular-values, 1 to 4; 4 by default.")
@click.option("--values", help="Which of the three singular values are used; 2,3 by default.")
@OUT
@store_options
def command(
    batch: bool,
    filtering: FilterOptions,
    initial: Path,
    matches: str,
    parameters: str | None,
    residual_name: str,
    groups: int | None,
    values: str | None,
    out: Path,
    selection: Selection,
    workforce: Workforce,
    as_json: bool,
) -> None:
    """Refit the camera and update C_SD, with --batch or --sequential METHOD.

    Writes fit.json and report.html into --out, and calibration.json when every gate lets the fit
    pass; a refused fit ends with exit code 4 and its reasons.  A sequential fit also writes
    history.parquet (a row per frame) and state.json, from which --state goes on.
    """
    from stcal.atomic import staged
    from stcal.calibration import load, sha256_of
    from stcal.errors import UsageError

    if batch == (filtering.method is not None):
        raise UsageError("say how to fit: --batch or --sequential METHOD")
    filtering.check(batch)
    own_folder(out)
    parent = load(initial)
    residual = _residual(residual_name, groups, values)
    names = None if parameters is None else tuple(p.strip() for p in parameters.split(","))
    label = f"fit {selection.sensor}"
    with workforce.map() as mapper:
        inputs = read_inputs(selection, mapper)
        parentage = {"parent_sha256": sha256_of(initial)}
        inputs = replace(inputs, provenance=inputs.provenance | parentage)
        # The calibration goes first and comes last: it is always that of the other files.
        with staged(out, last=FITTED) as stage:
            if batch:
                document, calibration = _batch(
                    inputs, parent, matches, names, residual, mapper, label, out
                )
            else:
                document, calibration = _sequential(
                    inputs, parent, matches, names, residual, mapper, label, filtering, stage
                )
            _write(document, calibration, stage)
    conclude(document, as_json, lambda console: _tables(document, console))


def _residual(name: str, groups: int | None, values: str | None) -> Residual:
    """Return the residual that the options describe.

    Raises
    ------
    UsageError
    """
    from stcal.errors import UsageError
    from stcal.residuals import Residual

    residual = Residual(name)
    if name != "singular-values" and not (groups is None and values is None):
        raise UsageError("--groups and --values belong to --residual singular-values")
    if groups is not None:
        residual = replace(residual, groups=groups)
    if values is not None:
        try:
            residual = replace(residual, values=tuple(int(v) for v in values.split(",")))
        except ValueError:
            raise UsageError(f"--values {values!r} is not a list such as 2,3") from None
    residual.check()
    return residual


def _batch(
    inputs: Inputs,
    parent: Calibration,
    matches: str,
    names: tuple[str, ...] | None,
    residual: Residual,
    mapper: OrderedMap,
    label: str,
    out: Path,
) -> tuple[dict[str, Any], Calibration | None]:
    from stcal.pipeline.fit import fit_batch
    from stcal.pipeline.scratch import scratch_folder

    with scratch_folder(out) as scratch, progress(label) as bar:
        result = fit_batch(
            inputs.fragments, parent, inputs.matcher, inputs.provenance, matches, names, residual,
            watched(mapper, bar), scratch,
            lambda cycle: bar.describe(f"{label}, {cycle.name} done"),
        )  # fmt: skip
    return result.document, result.calibration


def _sequential(
    inputs: Inputs,
    parent: Calibration,
    matches: str,
    names: tuple[str, ...] | None,
    residual: Residual,
    mapper: OrderedMap,
    label: str,
    filtering: FilterOptions,
    out: Path,
) -> tuple[dict[str, Any], Calibration | None]:
    from stcal.pipeline.filter_state import StateFile, save_state
    from stcal.pipeline.sequential import fit_sequential
    from stcal.telemetry.history import write_history

    variant = filtering.variant(matches, names, residual, inputs.matcher.config)
    setting = filtering.setting(variant, parent, inputs.provenance)
    states, before = filtering.earlier(setting, HISTORY)
    with progress(label, total=len(inputs.fragments)) as bar:
        result = fit_sequential(
            inputs.batches, parent, inputs.matcher, inputs.provenance, variant, states, before,
            mapper, bar.advance,
        )  # fmt: skip
    for name, run in result.runs.items():
        history = HISTORY if name == "constant" else f"{name}-{HISTORY}"
        write_history(run.history, run.filter, out / history)
    save_state(StateFile(setting, result.states), out / STATE)
    return result.document, result.calibration


def _write(document: dict[str, Any], calibration: Calibration | None, out: Path) -> None:
    from stcal.calibration import save

    write_documents(document, out / DOCUMENT, out / REPORT)
    if calibration is not None:
        save(calibration, out / FITTED)


def _tables(document: dict[str, Any], console: Console) -> None:
    from stcal.report.tables import fit_tables

    fit_tables(document, console)
