"""`python -m framecast`: the command, also where scripts are not on the path."""

import sys

from framecast.cli import main

sys.exit(main())
