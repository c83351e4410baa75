// What the page keeps in its address, after the #. Each view uses keys of its own.

/** Return the value of a key, of the page's address or of another one, or null. */
export function remembered(key, address = location.href) {
  return new URLSearchParams(new URL(address).hash.slice(1)).get(key);
}

export function remember(key, value) {
  const values = new URLSearchParams(location.hash.slice(1));
  if (value === null) values.delete(key);
  else values.set(key, value);
  history.replaceState(null, "", `#${values}`);
}
