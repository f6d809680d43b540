from agglo_core.agglomeration.keywords import Choice as Choice
from agglo_core.agglomeration.one_call import agglomerate as agglomerate
from agglo_core.agglomeration.pipeline import Pipeline as Pipeline
