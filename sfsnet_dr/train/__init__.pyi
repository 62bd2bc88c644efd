# The public names of ``sfsnet_dr.train`` and where they come from.
from .averaging import average_weights as average_weights
from .config import Recipe as Recipe
from .config import read_recipe as read_recipe
from .run import TrainResult as TrainResult
from .trainer import train as train
