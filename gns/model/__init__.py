"""The network: graph, encoder, processor, decoder, grid context; the simulator that it makes; its files."""
