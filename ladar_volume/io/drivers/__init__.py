"""What the drivers of scanners write: point layouts by name, times of returns, raw packets, pcap
files, frames.
"""
