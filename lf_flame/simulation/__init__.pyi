from .assumptions import assume as assume
from .measuring import measure_changes as measure_changes
from .plan import EffectPlan as EffectPlan
from .plan import plan_effects as plan_effects
from .rendering import render as render
