"""Bundles, manifests, relighting on the fly and photographs."""
