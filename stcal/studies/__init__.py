"""Studies on simulated sensors: a paper's tests run anew, and which of its findings hold here.

A study returns one document with its numbers, the published ones and the findings; the report is
made of that document alone.
"""
