# The public names of ``sfsnet_dr.metrics`` and where they come from.
from .bootstrap import Interval as Interval
from .bootstrap import bootstrap_interval as bootstrap_interval
from .equivalence import Agreement as Agreement
from .equivalence import Estimate as Estimate
from .equivalence import check_agreement as check_agreement
from .image import flip_metric as flip_metric
from .image import mae_8bit as mae_8bit
from .image import psnr as psnr
from .image import rel_rmse as rel_rmse
from .image import rmse_8bit as rmse_8bit
from .light import light_direction as light_direction
from .noise_free import RelativeRmse as RelativeRmse
from .noise_free import relative_rmse as relative_rmse
from .normals import NormalErrors as NormalErrors
from .normals import angles_deg as angles_deg
from .normals import angular_error_deg as angular_error_deg
