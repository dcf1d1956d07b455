"""Reports of fits and validations, made from their JSON documents alone.

``document`` reads a document, ``content`` turns it into tables of text, ``figures`` into SVG;
``html`` and ``tables`` lay these out for a browser and for a terminal.
"""
