"""Bilateral teleoperation, block by block: every block a port with an energy ledger."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach(
    __name__,
    submod_attrs={
        "channel": ["ChannelRun", "channel_run", "switched_channel_run"],
        "delays": ["Delay", "constant_delay", "random_walk_delay", "recorded_delay"],
        "filters": [
            "FilterRun",
            "PassivityMargin",
            "TwoPortFilter",
            "WaveFilter",
            "corrected_filter",
            "passivity_margin",
            "printed_filter",
            "sinusoid_energy",
        ],
        "loop.schemes": ["SCHEMES", "Scheme"],
        "loop.settings": ["STUDIES", "DivergenceError", "LoopSettings"],
        "ports.device": ["HapticDevice", "PassivityError"],
        "ports.ledger": ["EnergyLedger"],
        "ports.passivity": ["PassivityController"],
        "ports.waves": ["Scattering"],
        "team.leader_policies": ["GivenSequence", "LeaderPolicy", "MostTrusted", "RandomLeaders"],
        "team.settings": [
            "GraphError",
            "TeamOperator",
            "TeamSettings",
            "algebraic_connectivity",
            "team_graph",
        ],
        "transparency": [
            "Tuning",
            "dominance",
            "gains",
            "ideal_distances",
            "rendered_impedance",
            "tune_transparency",
        ],
    },
)
