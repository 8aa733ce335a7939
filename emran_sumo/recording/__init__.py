"""What a run leaves behind: the Rerun recording and the trace table."""
