from .planning.decisions import plan_effects as plan_effects
from .planning.plan import EffectPlan as EffectPlan
from .planning.plan import assume as assume
from .rendering import measure_changes as measure_changes
from .rendering import render as render
