"""`python -m tests.mutants`."""

from tests.mutants.harness import main

raise SystemExit(main())
