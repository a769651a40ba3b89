# %% [markdown]
# # A network, its ECG, and what pacing makes of a block
#
# The packaged heart, the example network, and scenarios of the library. Nothing else is needed.

# %%
from dataclasses import replace

import fascicle

heart = fascicle.load_heart("default")
model = fascicle.ForwardModel(heart)

# %% [markdown]
# One run of the forward model: both trees grow, the eikonal equation is solved in trees and
# myocardium together, the ECG is integrated over the heart. Parameters that do not fit the
# endocardia give an `Infeasible`, with the reason.

# %%
parameters = fascicle.example_parameters(model)
own = model.simulate(parameters)
assert isinstance(own, fascicle.Beat), own.reason
v1 = own.ecg.sel(lead="V1")  # xarray, mV over ms
print(f"V1 from {float(v1.min()):.2f} to {float(v1.max()):.2f} mV")
print(f"QRS {own.qrs_duration:.0f} ms, activation {own.total_activation_time:.0f} ms")

# %% [markdown]
# Scenarios change stimulation and conduction, not the network. `fascicle scenarios` lists the
# library; a file of your own, or a `fascicle.Scenario`, does as well.

# %%
NAMES = [
    "left-bundle-branch-block",
    "left-bundle-branch-pacing",
    "rv-apical-pacing",
    "biventricular-pacing",
]
scenarios = fascicle.read_scenarios(NAMES)
simulated = {name: model.simulate(parameters, scenario) for name, scenario in scenarios.items()}
for name, simulation in simulated.items():
    print(
        f"{name:<26} QRS {simulation.qrs_duration:3.0f} ms, activation "
        f"{simulation.total_activation_time:3.0f} ms"
    )

# %% [markdown]
# These pacings are of a heart without a block: from the left bundle the front climbs to the His
# bundle and comes down on the right. With the block in place it cannot, and the right ventricle is
# late instead of the left one.

# %%
pacing = scenarios["left-bundle-branch-pacing"]
with_block = pacing.mapped(
    lambda part: replace(part, left=0.0) if isinstance(part, fascicle.His) else part
)
paced = model.simulate(parameters, with_block)
blocked = simulated["left-bundle-branch-block"]
print(f"paced, with the block: QRS {paced.qrs_duration:.0f} ms")
assert blocked.qrs_duration > own.qrs_duration + 10
assert simulated["left-bundle-branch-pacing"].qrs_duration + 10 < paced.qrs_duration
assert paced.qrs_duration < blocked.qrs_duration
