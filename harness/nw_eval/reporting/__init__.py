"""Reports: verdict and rows in, text for people out. Imports no simulation."""
