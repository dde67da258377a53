"""
The teleoperation loop in Drake: a LeafSystem that steps in NumPy, and a linear part of the loop in
Drake's own compiled blocks.
"""

from plain_loop import PlainLoop
from serve import serve


def ways(data):
    from pydrake.systems.analysis import Simulator
    from pydrake.systems.framework import DiagramBuilder, EventStatus, LeafSystem
    from pydrake.systems.primitives import (
        Demultiplexer,
        DiscreteTimeDelay,
        LinearSystem,
        LogVectorOutput,
        Multiplexer,
    )

    period, count = float(data["settings"][0]), len(data["reference"])

    class Loop(LeafSystem):
        def __init__(self):
            super().__init__()
            self.loop, self.k = PlainLoop(data), 0
            row = self.DeclareDiscreteState(52)
            self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self.sample)
            self.DeclareStateOutputPort("row", row)

        def sample(self, context, after):
            if self.k < count:
                after.set_value(0, self.loop.step(self.k))
            self.k += 1
            return EventStatus.Succeeded()

    def leaf(samples):
        builder = DiagramBuilder()
        system = builder.AddSystem(Loop())
        logger = LogVectorOutput(system.get_output_port(), builder, period)
        simulator = Simulator(builder.Build())
        simulator.AdvanceTo((samples + 0.5) * period)
        log = logger.FindLog(simulator.get_context())
        return log.data()[
            :, 1 : samples + 1
        ].T  # published at a time is what was updated the sample before

    def linear():
        """
        Device, waves, constant delays and vehicle, driven by oscillators: discrete linear systems,
        no Python in the loop.
        """
        builder, parts = DiagramBuilder(), {}
        for name in ("source", "master", "slave"):
            matrices = [data[f"{name}_{letter}"] for letter in "abcd"]
            parts[name] = builder.AddSystem(LinearSystem(*matrices, period))
            parts[name, "out"] = builder.AddSystem(Demultiplexer([3, 3]))
            builder.Connect(parts[name].get_output_port(), parts[name, "out"].get_input_port())
        for i, (name, other) in enumerate((("slave", "master"), ("master", "slave"))):
            join = builder.AddSystem(Multiplexer([3, 3]))
            delay = builder.AddSystem(DiscreteTimeDelay(period, int(data["late"][i]), 3))
            builder.Connect(parts["source", "out"].get_output_port(1 - i), join.get_input_port(0))
            builder.Connect(parts[other, "out"].get_output_port(0), delay.get_input_port())
            builder.Connect(delay.get_output_port(), join.get_input_port(1))
            builder.Connect(join.get_output_port(), parts[name].get_input_port())
        watch = builder.AddSystem(Multiplexer([3, 3]))
        for i, name in enumerate(("master", "slave")):
            builder.Connect(parts[name, "out"].get_output_port(1), watch.get_input_port(i))
        logger = LogVectorOutput(watch.get_output_port(), builder, period)
        diagram = builder.Build()
        simulator = Simulator(diagram)
        for name in ("source", "slave"):
            inner = diagram.GetMutableSubsystemContext(parts[name], simulator.get_mutable_context())
            inner.SetDiscreteState(data[f"{name}_start"])
        simulator.AdvanceTo((count - 0.5) * period)
        return logger.FindLog(simulator.get_context()).data()[:, :count].T

    short = min(count, 2000)
    return {
        "leaf": lambda: leaf(count)[-1],
        "leaf, first samples": lambda: leaf(short).ravel(),
        "linear": lambda: linear()[::100].ravel(),
    }


serve("drake", ways)
