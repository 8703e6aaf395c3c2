"""Run the command-line interface by ``python -m rfpsurvey``."""

from rfpsurvey._cli.process import main

if __name__ == "__main__":
    main()
