"""Upload files: encoders, independent decoders, gates, and the comparison of two calibrations."""
