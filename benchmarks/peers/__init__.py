"""Peers: in this process (SciPy, CasADi), or in processes of their own (the workers)."""
