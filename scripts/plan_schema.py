"""Write the schema by which editors complete the keys of a plan (`just plan-schema`): `plans/plan.schema.json`."""

from __future__ import annotations

from pathlib import Path

from dds_trace.extensions.campaigns.plan.schema import schema_text

if __name__ == "__main__":
    path = Path(__file__).parents[1] / "plans/plan.schema.json"
    path.write_text(schema_text(), encoding="utf-8")
    print(f"Wrote {path}")
