"""What a recording that stays for weeks needs: files that are rotated, room on the disk, a word to systemd and to `status`."""
