"""Physical constants and unit factors, with their sources."""

from math import pi

# IAU 2012 resolution B2 (exact); CGPM 1983 (exact).
AU_M = 149_597_870_700.0
SPEED_OF_LIGHT_M_S = 299_792_458.0

# TAI - TT is exact by definition (IAU 1991 recommendation IV).
TT_MINUS_TAI_S = 32.184

DAY_S = 86_400.0
JULIAN_YEAR_S = 365.25 * DAY_S

DEG = pi / 180.0
ARCSEC = DEG / 3600.0
MAS = ARCSEC / 1000.0
URAD = 1e-6

# IERS Conventions (2010), tables 1.1 and 1.2: used by the simulator's orbits.
EARTH_GM_M3_S2 = 3.986_004_418e14
EARTH_RADIUS_M = 6_378_136.6
EARTH_J2 = 1.082_635_9e-3

EXPOSURES_PER_FRAME = 2
