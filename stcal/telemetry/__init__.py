"""Downlinked telemetry: decoders, validation, the Parquet store, quarantine, writers."""
