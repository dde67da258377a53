"""
What trustlab costs beside other tools; run by `make bench`, or `python -m benchmarks` for what is
installed.

Times are medians of repetitions taken in turns (ours, peer, ours, peer …) in one run, with their
least and greatest; what counts is the ratio, taken within each turn. Every process has one BLAS
thread. A peer's result is checked before it is timed.
"""
