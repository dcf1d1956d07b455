"""The stages, from stored telemetry to documents that reports and uploads are made of."""
