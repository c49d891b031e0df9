"""Reference motions that policies are trained to track, read from the files of others."""
