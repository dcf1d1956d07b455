"""The telemetry columns of the long form, each with its unit: stated once for every decoder."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Column:
    """One column of telemetry; ``required`` ones must be in a CSV header."""

    name: str
    unit: str
    required: bool = True


FRAME_COLUMNS = (
    Column("sensor_id", "text"),
    Column("frame_id", "1"),
    Column("time_utc", "ISO 8601 UTC"),
    Column("best_exposure", "1"),
    Column("q_x", "1"),
    Column("q_y", "1"),
    Column("q_z", "1"),
    Column("q_w", "1"),
    Column("rate_x_deg_s", "deg/s"),
    Column("rate_y_deg_s", "deg/s"),
    Column("rate_z_deg_s", "deg/s"),
    Column("temperature_c", "degC"),
)
STAR_COLUMNS = (
    Column("exposure", "1"),
    Column("row_px", "px"),
    Column("col_px", "px"),
    Column("intensity", "counts"),
    Column("star_id", "text"),
)
OPTIONAL_COLUMNS = (
    Column("eclipse", "1", required=False),
    Column("intrusion", "1", required=False),
    Column("pos_x_km", "km", required=False),
    Column("pos_y_km", "km", required=False),
    Column("pos_z_km", "km", required=False),
    Column("vel_x_km_s", "km/s", required=False),
    Column("vel_y_km_s", "km/s", required=False),
    Column("vel_z_km_s", "km/s", required=False),
)
COLUMNS = FRAME_COLUMNS + STAR_COLUMNS + OPTIONAL_COLUMNS
UNITS = {column.name: column.unit for column in COLUMNS}

# The vectors of a frame, by the FrameBatch field they become.
VECTORS = {
    "q_si": ("q_x", "q_y", "q_z", "q_w"),
    "rate_deg_s": ("rate_x_deg_s", "rate_y_deg_s", "rate_z_deg_s"),
    "pos_km": ("pos_x_km", "pos_y_km", "pos_z_km"),
    "vel_km_s": ("vel_x_km_s", "vel_y_km_s", "vel_z_km_s"),
}
FLAGS = ("eclipse", "intrusion")
# The frame's real numbers, in the order in which they are kept side by side.
FRAME_NUMBERS = (
    *VECTORS["q_si"],
    *VECTORS["rate_deg_s"],
    "temperature_c",
    *VECTORS["pos_km"],
    *VECTORS["vel_km_s"],
)
