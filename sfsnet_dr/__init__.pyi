# The public names and where they come from: read by type checkers, and by `import sfsnet_dr` itself.
from . import metrics as metrics
from . import sh as sh
from . import train as train
from .api import build_subject as build_subject
from .api import load_scene as load_scene
from .api import path_trace as path_trace
from .api import relight as relight
from .api import render_aovs as render_aovs
from .api import sample_light as sample_light
from .api import shade as shade
from .api import validate as validate
from .data.dataset import RelitFaces as RelitFaces
from .data.dataset import load_faces as load_faces
from .data.generate import synthesize as synthesize
from .inference.decompose import decompose as decompose
from .inference.outputs import Decomposition as Decomposition
from .losses.sfsnet import sfsnet_loss as sfsnet_loss
from .models.inference import load_model as load_model
from .models.sfsnet import SfSNet as SfSNet
from .models.skipnet import SkipNet as SkipNet
from .models.skipnet import SkipNetPlus as SkipNetPlus
from .render.renderers.registry import find_renderer as find_renderer
from .render.transport_shading import Transport as Transport
from .render.transport_shading import relight_transport as relight_transport
from .report.record import Record as Record
from .scene.lights.light import Light as Light

__version__: str
__all__: list[str]
