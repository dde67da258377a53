"""
A within-subject study in the browser: the plan, its pages, its server, and what it leaves on the
disk.
"""
