"""OpenUSD fills its Python modules at run time and has no types: pyright takes everything in them as Any."""

from . import _any as Ar
from . import _any as Gf
from . import _any as Kind
from . import _any as Plug
from . import _any as Sdf
from . import _any as Tf
from . import _any as Usd
from . import _any as UsdGeom
from . import _any as UsdLux
from . import _any as UsdPhysics
from . import _any as UsdShade
from . import _any as UsdUtils
from . import _any as UsdValidation
from . import _any as Vt
