"""One MCAP file for each trial, with Foxglove's protobuf schemas and three of our own."""
