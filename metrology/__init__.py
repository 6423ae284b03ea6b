"""metrology: optical-shop figures of a height map: form, residual, slope error, Zernike terms.

| file | holds |
|---|---|
| `forms.py` | forms by name: plane, sphere, cylinder, paraboloid, conic; parameters free or fixed |
| `fit.py` | `fit_form`: least squares over the good pixels; `FormFit`: parameters with sigma, residual |
| `nominal.py` | a nominal height map or mesh after its rigid best fit |
| `lines.py` | profiles along lines, power spectral density |
| `zernike.py` | Zernike polynomials over the aperture, and their coefficients with sigma |
| `covariance.py` | covariance of fitted parameters by slope noise |

Lengths in mm, slopes in mm per mm; z > 0 is towards the camera: a concave mirror has a radius above 0.
"""

from optolever.arguments import check_face

from .fit import FormFit, Numbers, fit_form
from .forms import form_names
from .lines import Profile, Spectrum, profile, profile_of, spectrum
from .nominal import NOMINAL_SUFFIXES, Nominal, fit_nominal, load_nominal
from .zernike import ZernikeFit, fit_zernike, zernike

__all__ = [
    "NOMINAL_SUFFIXES",
    "FormFit",
    "Nominal",
    "Numbers",
    "Profile",
    "Spectrum",
    "ZernikeFit",
    "fit_form",
    "fit_nominal",
    "fit_zernike",
    "form_names",
    "load_nominal",
    "profile",
    "profile_of",
    "spectrum",
    "zernike",
]

check_face(__name__)
