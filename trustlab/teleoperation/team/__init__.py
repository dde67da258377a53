"""
One operator and a team of robots: settings, leader policies and the compiled loop of Fig. 4.1.
"""
