"use strict";
// Numbers for people, in the units and by the rules of base/units.py and reports/book/groups.py (a test compares them).
const { missing: MISSING, time: TIME_UNITS, bytes: BYTE_UNITS } = DATA.units;

function digits(value) {
  if (value === 0) return "0";
  const decimals = Math.max(0, 2 - Math.floor(Math.log10(Math.abs(value)) + 1e-12));
  const shown = value.toFixed(Math.min(decimals, 9));
  return shown.includes(".") ? shown.replace(/0+$/, "").replace(/\.$/, "") : shown;
}

/** A share in percent, without what binary fractions add. */
const percent = (share) => Math.round(share * 1e8) / 1e6;

function unitFor(value, units) {
  return units.find(([factor]) => Math.abs(value) >= 0.9995 * factor) || units[units.length - 1];
}

function inUnits(value, units) {
  if (value === null || value === undefined) return MISSING;
  const [factor, unit] = unitFor(value, units);
  return `${digits(value / factor)} ${unit}`;
}

const formatNs = (value) => inUnits(value, TIME_UNITS);
const formatBytes = (value) => inUnits(value, BYTE_UNITS);
const formatBytesPerS = (value) => (value === null || value === undefined ? MISSING : `${formatBytes(value)}/s`);
function formatHz(value) {
  if (value === null || value === undefined) return MISSING;
  return value === 0 ? "max" : `${digits(value)} Hz`;
}

function formatRatio(value) {
  if (value === null || value === undefined) return MISSING;
  const percent = 100 * value;
  if (percent > 0 && percent < 0.01) return "< 0.01 %";
  if (percent > 99.99 && percent < 100) return "> 99.99 %";
  return `${percent < 99 ? digits(percent) : percent.toFixed(2).replace(/\.?0+$/, "")} %`;
}

const COUNTS = new Intl.NumberFormat("en-US");
const formatCount = (value) => (value === null || value === undefined ? MISSING : COUNTS.format(Math.trunc(value)));
const counted = (count, one, many = `${one}s`) => `${formatCount(count)} ${count === 1 ? one : many}`;
const signed = (value, format) => (value > 0 ? "+" : "") + format(value);
