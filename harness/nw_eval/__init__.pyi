# What `nw_eval` has, for editors and type checkers; `__init__.py` imports it when it is used.

from typing import Any, TypeAlias

from typing_extensions import deprecated

from nw_base.errors import CodeError as CodeError
from nw_base.errors import FetchError as FetchError
from nw_base.errors import IncomparableError as IncomparableError
from nw_base.errors import NwEvalError as NwEvalError
from nw_base.errors import PluginError as PluginError
from nw_base.errors import PolicyError as PolicyError
from nw_base.errors import PrerequisiteError as PrerequisiteError
from nw_base.errors import SceneError as SceneError
from nw_base.errors import StoreError as StoreError
from nw_base.errors import SuiteError as SuiteError
from nw_base.errors import TrialError as TrialError
from nw_base.errors import UsageError as UsageError
from nw_eval.api import *
from nw_eval.engine.plan import Forecast as Forecast
from nw_eval.engine.plan import Plan as Plan
from nw_eval.viewing.recording.track import WrittenRecording as WrittenRecording
from nw_gate.ledger_report import LedgerReport as LedgerReport
from nw_gate.results.baseline import BaselineChange as BaselineChange
from nw_gate.results.baseline import BaselineResults as BaselineResults
from nw_gate.results.request import Request as Request
from nw_gate.results.row import Row as Row
from nw_gate.scores import Score as Score
from nw_gate.scores import ScoreSpec as ScoreSpec
from nw_gate.side_by_side import PolicyComparison as PolicyComparison
from nw_gate.stats.agreement import Agreement as Agreement
from nw_gate.verdict import Comparison as Comparison
from nw_gate.verdict import Verdict as Verdict
from nw_policies.cards.card import Card as Card
from nw_policies.cards.load import ListedPolicy as ListedPolicy
from nw_scenes.hub.reference import Fetched as Fetched
from nw_scenes.overview import SceneFigures as SceneFigures
from nw_sim.axes import Axis as Axis
from nw_sim.ladders import Ladder as Ladder
from nw_sim.ladders import Rung as Rung
from nw_sim.probe.report import ProbeReport as ProbeReport
from nw_sim.probe.robot_check import CheckedRobot as CheckedRobot
from nw_sim.probe.robot_check import RobotSummary as RobotSummary
from nw_sim.probe.summary import CardSummary as CardSummary
from nw_sim.rollout.replaying.reports import AttributionReport as AttributionReport
from nw_sim.rollout.replaying.reports import ReplayReport as ReplayReport
from nw_sim.rollout.replaying.reports import TakeoverReport as TakeoverReport
from nw_sim.rollout.replaying.rescored import LogScores as LogScores
from nw_sim.sensors.gallery import SeenCard as SeenCard
from nw_sim.tasks import Goal as Goal
from nw_sim.tasks import Task as Task
from nw_sim.tasks import TaskSettings as TaskSettings
from nw_splat.files.format import SplatFormat as SplatFormat
from nw_splat.gaussians import Gaussians as Gaussians
from nw_splat.gaussians import SplatFigures as SplatFigures

__version__: str

# Names until 0.1, which are understood for one release.
@deprecated("nw_eval.agree is now nw_eval.sim2real")
def agree(*args: Any, **keywords: Any) -> Agreement: ...
@deprecated("nw_eval.blame is now nw_eval.attribute")
def blame(*args: Any, **keywords: Any) -> Attribution: ...

BankChange: TypeAlias = BaselineChange
BlamePlan: TypeAlias = AttributionPlan
BlameReport: TypeAlias = AttributionReport
BlamedTrial: TypeAlias = AttributedTrial
Blames: TypeAlias = Attribution
SavedBank: TypeAlias = BaselineResults
