"""`python -m nw_eval`: what the script `nw-eval` does."""

from nw_eval.cli import main

if __name__ == "__main__":
    main()
