"""
A UAV that follows a ground robot (Section 2.4.2, Figs. 2.10–2.17): compiled loop, operators, runs.
"""
