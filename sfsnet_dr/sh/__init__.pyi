# The public names of ``sfsnet_dr.sh`` and where they come from.
from .basis import basis_index as basis_index
from .basis import from_scipy as from_scipy
from .basis import sh_basis as sh_basis
from .basis import to_drjit_index as to_drjit_index
from .coefficients import Radiance as Radiance
from .coefficients import Shading as Shading
from .kernel import band_of as band_of
from .kernel import clamped_cosine as clamped_cosine
from .projection import equirect_directions as equirect_directions
from .projection import equirect_solid_angles as equirect_solid_angles
from .projection import project_directional as project_directional
from .projection import project_equirect as project_equirect
from .rotation import rotate as rotate
from .rotation import rotation_matrix as rotation_matrix
