"""What the processes of the simulated bench share: state, wiring, folders."""
