"""metrology: optical-shop figures of a height map: form, residual, slope error, Zernike terms.

| file | holds |
|---|---|
| `forms.py` | forms by name: planes, sphere, conics, asphere, off-axis, cylinder; numbers free or fixed |
| `fit.py` | `fit_form`: least squares over the good pixels; `FormFit`: parameters with sigma, residual |
| `nominal.py` | a nominal height map or mesh after its rigid best fit |
| `lines.py` | profiles along lines, power spectral density |
| `zernike.py`, `zernike_terms.py` | Zernike coefficients with sigma; polynomials, indices, names |
| `apertures.py` | circle, ellipse, rectangle, image: the pixels that figures are of |
| `filters.py` | high and low pass |
| `runs.py` | mean and difference of runs, rotated ones too |
| `figures.py` | PVr, rms less its noise, waves, limits |
| `slope_error.py` | `slope_errors`: rms of the residual's slopes, less their noise, with sigma |
| `functionals.py` | covariance of fitted parameters and of residuals, by slope noise |

Lengths in mm, slopes in mm per mm; z > 0 is towards the camera: a concave mirror has a radius above 0.
"""

from .apertures import aperture_circle, aperture_mask
from .figures import Verdict, in_waves, judge, pvr
from .filters import gaussian_filter
from .fit import FOREIGN, FormFit, Numbers, fit_form
from .forms import form_names
from .lines import Profile, Spectrum, profile, profile_of, spectrum
from .nominal import NOMINAL_SUFFIXES, Nominal, fit_nominal, grid_of, load_measured, load_nominal
from .runs import RunComparison, compare_runs, in_common
from .slope_error import SlopeError, slope_errors
from .zernike import ZernikeFit, fit_zernike
from .zernike_terms import ansi_index, fringe_index, zernike, zernike_name

__all__ = [
    "FOREIGN", "NOMINAL_SUFFIXES", "FormFit", "Nominal", "Numbers", "Profile", "RunComparison",
    "SlopeError", "Spectrum", "Verdict", "ZernikeFit", "ansi_index", "aperture_circle", "aperture_mask",
    "compare_runs", "fit_form", "fit_nominal", "fit_zernike", "form_names", "fringe_index",
    "gaussian_filter", "grid_of", "in_common", "in_waves", "judge", "load_measured", "load_nominal",
    "profile", "profile_of", "pvr", "slope_errors", "spectrum", "zernike", "zernike_name",
]  # fmt: skip
