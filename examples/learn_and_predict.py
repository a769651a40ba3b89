# %% [markdown]
# # From an ECG file to a comparison of pacings
#
# The 12-lead DICOM recording that comes inside pydicom, on the packaged heart, which is not this
# person's: so it explains three quarters of the QRS. Twenty networks are drawn rather than 300,
# enough to see every stage work; the first line of the result says whether the runs agree all the
# same.

# %%
import tempfile
from pathlib import Path

from pydicom.data import get_testdata_file

import fascicle

folder = Path(tempfile.mkdtemp())

# %% [markdown]
# The target: beats found, sorted by shape and aligned; their mean, their spread, and the QRS
# window.

# %%
recording = Path(str(get_testdata_file("waveform_ecg.dcm", download=False)))
target = fascicle.make_target(fascicle.read_recording(recording))
print(f"{len(target.beats)} beats, QRS {target.qrs_duration:.0f} ms")

# %%
_ = fascicle.plot.target(target)

# %% [markdown]
# The fit. Without `effective` it draws 300 networks; started again with the same folder, it goes
# on.

# %%
study = fascicle.fit("default", target, folder / "study", effective=20)
print(study.verdict)

# %%
_ = fascicle.plot.ecg(study)

# %% [markdown]
# Scenarios are predicted in every network: the spread of the networks is what the ECG leaves open.

# %%
predicted = fascicle.predict(study, ["left-bundle-branch-pacing", "rv-apical-pacing"])
_ = fascicle.plot.indices(predicted)

# %%
comparison = fascicle.compare(
    predicted["left-bundle-branch-pacing"], predicted["rv-apical-pacing"], "total_activation_time"
)
low, high = comparison.interval
print(f"probability to be faster {comparison.probability():.2f}, by {low:.0f} to {high:.0f} ms")
for name, share in comparison.variance_explained_by(study.population.values)[:3]:
    print(f"{share:.0%} of the difference between networks goes with {name}")

# %% [markdown]
# Everything on one page, to read in a browser and to send to somebody.

# %%
page, *_ = fascicle.report(study, out=folder / "report.html")
print(page.as_uri())
