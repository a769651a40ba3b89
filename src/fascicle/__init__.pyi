# The public names: for type checkers, and for `__init__.py`, which loads each when it is used.
from . import plot as plot
from .core.errors import InputError as InputError
from .core.files import outside_allowed as outside_allowed
from .core.parameters import EXAMPLE_PARAMETERS as EXAMPLE_PARAMETERS
from .core.parameters import NETWORK_SPACE as NETWORK_SPACE
from .core.quantities import QUANTITIES as QUANTITIES
from .forward.example import example_parameters as example_parameters
from .forward.model import ForwardModel as ForwardModel
from .forward.scenario import His as His
from .forward.scenario import Scenario as Scenario
from .forward.scenario import Slowing as Slowing
from .forward.scenario import Stimulus as Stimulus
from .forward.scenario_files import read_scenarios as read_scenarios
from .forward.simulation import Simulation as Simulation
from .heart.conduction import Conduction as Conduction
from .heart.conduction import Region as Region
from .heart.folder import load_heart as load_heart
from .heart.heart import Heart as Heart
from .prediction.comparison import Comparison as Comparison
from .prediction.comparison import compare as compare
from .prediction.scenarios import Predicted as Predicted
from .prediction.scenarios import predict as predict
from .purkinje.growth import GrowthRules as GrowthRules
from .purkinje.tree import InvalidTree as InvalidTree
from .purkinje.tree import PurkinjeTree as PurkinjeTree
from .recording.choices import Choices as Choices
from .recording.pipeline import analyse as analyse
from .recording.pipeline import make_target as make_target
from .recording.readers.read import read_recording as read_recording
from .recording.target_files import read_target as read_target
from .reporting.page.page import report as report
from .study.bank import make_bank as make_bank
from .study.fit import fit as fit
from .study.fit import load_study as load_study
from .study.settings import FitSettings as FitSettings

__version__: str
