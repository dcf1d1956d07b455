"""File formats of upload tables: an encoder and, written apart from it, a decoder of each."""
