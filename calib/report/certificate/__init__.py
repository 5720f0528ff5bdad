"""Digital calibration certificates (DCC, schema 3.x of PTB): what they need, how they are written, read and checked."""
