"""Uncertain parameter, initial condition, sensor, actuator and forcing, all in one expansion.

A heated stage is held at 60 °C by a proportional controller. Its insulation varies with its manufacture and its first
temperature with its history; the thermometer and the heater are noisy; the temperature of the air drifts. How cheap,
that is, how noisy, may the thermometer be if the stage must end within half a degree, and which gain is best?
"""

from typing import ClassVar

import aleator as al

DURATION = 60.0  # s
SETPOINT, ROOM = 60.0, 22.0  # °C
NOMINAL_LOSS = 0.8  # W/K


class HeatedStage(al.System):
    """A stage of uniform temperature (°C), heated by the controller and cooled by the air."""

    states = ("temperature",)
    units: ClassVar = {"error": "K", "power": "W"}
    capacity: al.Number = al.parameter("J/K", positive=True)
    loss: al.Number = al.parameter("W/K", positive=True)
    first: al.Number = al.parameter("°C")
    gain: al.Number = al.parameter("W/K")

    def initial(self):
        """The first temperature, which depends on the stage's history."""
        return {"temperature": self.first}

    def power(self, z, sensor, heater):
        """The nominal power for the setpoint, corrected by the reading of the noisy thermometer."""
        return heater + self.gain * (SETPOINT - (z.temperature + sensor))

    def rhs(self, t, z, sensor, heater, air):
        """The heat balance."""
        return ((self.power(z, sensor, heater) - self.loss * (z.temperature - air)) / self.capacity,)

    def outputs(self, t, z, sensor, heater):
        """The deviation from the setpoint, and the heater's power."""
        return {"error": z.temperature - SETPOINT, "power": self.power(z, sensor, heater)}


stage = HeatedStage(
    capacity=50.0,
    loss=al.Uniform(NOMINAL_LOSS, half_width=0.1),  # the parameter
    first=al.Normal(SETPOINT, 1.0),  # the initial condition
    gain=al.Decision(8.0, 0.0, 40.0),
)
inputs = {
    "sensor": al.processes.RandomProcess(  # K
        al.processes.BandLimitedCovariance(0.0, 0.05), t_final=DURATION, std=al.Decision(0.1, 0.01, 1.0), energy=0.95
    ),
    "heater": al.processes.RandomProcess(  # W
        al.processes.ExponentialCovariance(30.0),
        t_final=DURATION,
        std=1.0,
        mean=NOMINAL_LOSS * (SETPOINT - ROOM),
        energy=0.9,
    ),
    "air": al.processes.RandomProcess(  # °C
        al.processes.SquaredExponentialCovariance(20.0), t_final=DURATION, std=1.5, mean=ROOM, energy=0.99
    ),
}
problem = al.Problem(
    stage,
    grid=al.Grid(DURATION, steps=120),
    inputs=inputs,
    minimize=al.cost.reciprocal("inputs.sensor.std", bias=1.0, scale=0.1),
    subject_to=[
        al.terminal("error").within(-0.5, 0.5, sigmas=2.0),
        al.path("power").within(10.0, 60.0, sigmas=2.0),
    ],
    expansion=al.Expansion(order=2),
)
for name, process in inputs.items():
    print(f"{name}: {process}")
solution = al.solve(problem)
print(solution)
print(al.validate(solution, samples=10_000))
