"""``stcal study``: studies on simulated sensors, one module a study."""

from __future__ import annotations

import click

from stcal.cli import study_enright, study_estimators, study_tracking, study_wu, study_zhang


@click.group(name="study")
def command() -> None:
    """Run a study on simulated sensors and write its report."""


command.add_command(study_enright.command)
command.add_command(study_tracking.command)
command.add_command(study_estimators.command)
command.add_command(study_wu.command)
command.add_command(study_zhang.command)
