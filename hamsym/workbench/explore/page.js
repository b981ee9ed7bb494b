// The player of the page, which shows what Python sends, and the address, which keeps its values.
// Names with a dot are those of the page; all others are variables of H, or the time span.

const state = {};
let player = null;

const keep = () => keepInAddress({ ...(player?.problem ? player.values : {}), ...state });

/** Keep what belongs to the page in the address, such as H and the tab. */
window.hamsymKeep = (values) => {
  Object.assign(state, values);
  for (const name of Object.keys(state)) if (state[name] === "") delete state[name];
  keep();
};

/** Texts and values of the address, by name. */
window.hamsymAddress = () => Object.fromEntries(new URLSearchParams(location.hash.slice(1)));

/** Show a system: its code in JavaScript, its problem, and its present values. */
window.hamsymShow = async (code, problem, values) => {
  const url = URL.createObjectURL(new Blob([code], { type: "text/javascript" }));
  const system = await import(url);
  URL.revokeObjectURL(url);
  player ??= new Player(document.querySelector(".player"), (moved) => {
    keep();
    emitEvent("moved", moved);
  });
  player.load(system, problem, values);
};
