"""Recalibrate star trackers in orbit from downlinked telemetry.

Conventions, stated once and used everywhere
--------------------------------------------
Frames
    I   inertial, ICRF
    D   detector: x along increasing row m, y along increasing column n, z out along the boresight
        (virtual detector in front of the pinhole, no image inversion)
    S   the sensor's external frame, to which the telemetered quaternion refers
    B   spacecraft body
Rotations
    ``c_ab`` is the matrix that takes components in frame b to components in frame a:
    ``v_a = c_ab @ v_b``.  ``c_sd`` is the sensor's stored alignment, ``c_di`` the attitude of one
    exposure in the detector frame, and ``c_si = c_sd @ c_di``.
    ``q_si`` is the telemetered quaternion, scalar last, unit norm, ``A(q_si) = c_si``, so that
    ``scipy.spatial.transform.Rotation.from_quat(q_si).apply(v_s) == v_i``.
Directions
    ``s_d``, ``s_s``, ``s_i``: unit star vectors in the frame that the suffix names.
Letters
    F frames, E = 2 F exposures, S stars (detections), P camera parameters, N stars of one exposure.
Units
    SI inside (m, rad, s); a name carries its unit where it is anything else (``_px``, ``_urad``,
    ``_arcsec``, ``_deg``, ``_km``, ``_mas``).  ``sd`` is a standard deviation, one sigma.
Time
    ``t_tai_ns``: int64 nanoseconds of TAI since 1970-01-01T00:00:00 TAI.

The unit of data is a batch of frames held as columns, :class:`stcal.frames.FrameBatch`.
"""

from stcal.version import __version__

__all__ = ["__version__"]
