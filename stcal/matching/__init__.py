"""Star identification: lost in space and guided, both ending in one consistency check."""

from stcal.matching.identify import METHODS, REASONS, Matcher, match

__all__ = ["METHODS", "REASONS", "Matcher", "match"]
