"""Bilateral teleoperation, block by block: every block a port with an energy ledger."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach(
    __name__,
    submod_attrs={
        "channel": ["EnergyLedger", "channel_run"],
        "delays": ["constant_delay", "random_walk_delay", "recorded_delay"],
        "haptic_device": ["HapticDevice", "PassivityError"],
        "passivity": ["PassivityController"],
        "scattering": ["Scattering"],
    },
)
