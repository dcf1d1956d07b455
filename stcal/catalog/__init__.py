"""Star catalogues: the bundled one, the official files' readers, and apparent places."""
