from .measuring import measure_changes as measure_changes
from .planning.assumptions import assume as assume
from .planning.decisions import plan_effects as plan_effects
from .planning.plan import EffectPlan as EffectPlan
from .rendering import render as render
