"""Where the package, its generated modules and the build's programs are, as for the tests: BARYCAST_PYTHON_PROTO names
<build>/python, BARYCAST_BIN_DIR <build>/bin; without them, those of this checkout. Import it before `barycast`."""

import os
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
BIN = Path(os.environ.get("BARYCAST_BIN_DIR", ROOT / "build" / "bin")).resolve()
PROTO = Path(os.environ.get("BARYCAST_PYTHON_PROTO", BIN.parent / "python")).resolve()

sys.path[:0] = [str(ROOT / "client_examples" / "python"), str(PROTO)]
os.environ.setdefault("BARYCASTD", str(BIN / "barycastd"))
