from .assumptions import assume as assume
from .assumptions import measure_changes as measure_changes
from .planning.plan import EffectPlan as EffectPlan
from .planning.plan import plan_effects as plan_effects
from .rendering import render as render
