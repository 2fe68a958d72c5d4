"""Many solves of one problem: fronts, many starts, trade-offs, calibrations, cross-checks, evidence on all of them."""

from aleator.sweep._calibrate import Calibration as Calibration
from aleator.sweep._calibrate import calibrate as calibrate
from aleator.sweep._conflict import Conflict as Conflict
from aleator.sweep._conflict import Limit as Limit
from aleator.sweep._conflict import conflict as conflict
from aleator.sweep._cross_check import CrossChecked as CrossChecked
from aleator.sweep._cross_check import cross_check as cross_check
from aleator.sweep._front import SAME as SAME
from aleator.sweep._front import Front as Front
from aleator.sweep._front import Refused as Refused
from aleator.sweep._front import pareto as pareto
from aleator.sweep._front import point_name as point_name
from aleator.sweep._harden import Hardened as Hardened
from aleator.sweep._harden import harden as harden
from aleator.sweep._margins import Trial as Trial
from aleator.sweep._portfolio import multistart as multistart
from aleator.sweep._portfolio import portfolio as portfolio
from aleator.sweep._starts import Optimum as Optimum
from aleator.sweep._starts import Portfolio as Portfolio
from aleator.sweep._starts import Starts as Starts
from aleator.sweep._trade_off import TradeOff as TradeOff
from aleator.sweep._trading import trade_off as trade_off
from aleator.sweep._validate_all import EvidenceOfAll as EvidenceOfAll
from aleator.sweep._validate_all import validate_all as validate_all
from aleator.sweep._workers import workers as workers
