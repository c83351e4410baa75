"""How every stage is computed: in memory, or in bands with its maps in files."""
