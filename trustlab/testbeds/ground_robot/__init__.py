"""
The ground robot of Fig. 2.1: course, robot, compiled loop, conditions C1–C5, runs and their
figures.
"""
