// Browsers start no workers from pages that are opened as files. There this class runs the script of a worker in a
// hidden frame of the page. The search of the theme finds it by the name `IFrameWorker`.
"use strict";
if (location.protocol === "file:") {
  window.Worker = window.IFrameWorker = class extends EventTarget {
    constructor(url) {
      super();
      this.frame = document.createElement("iframe");
      this.frame.hidden = true;
      this.frame.srcdoc = "<body></body>";
      this.started = new Promise((resolve) => (this.frame.onload = resolve)).then(() => this.start(url));
      document.body.append(this.frame);
    }

    start(url) {
      const inner = this.frame.contentWindow;
      const load = (source) =>
        new Promise((resolve, reject) => {
          const script = inner.document.createElement("script");
          Object.assign(script, { src: source, onload: resolve, onerror: reject });
          inner.document.body.append(script);
        });
      inner.importScripts = async (...sources) => {
        for (const source of sources) await load(source);
      };
      inner.postMessage = (data) => this.dispatchEvent(new MessageEvent("message", { data }));
      return load(new URL(url, location));
    }

    postMessage(data) {
      const receive = () => this.frame.contentWindow.dispatchEvent(new MessageEvent("message", { data }));
      this.started.then(receive);
    }

    terminate() {
      this.frame.remove();
    }
  };
}
