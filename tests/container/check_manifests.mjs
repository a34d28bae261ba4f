// Checks what `kubectl kustomize` builds: check_manifests.mjs MODULES FILE...
// Every object against the types of Kubernetes' API (TypeScript's compiler knows every field, the models' validation
// formats and values), and what must agree between objects: selectors, ports, probes, and
// that a pod has longer to end than its server has to drain. MODULES is the folder node_modules with kubernetes-models,
// typescript and yaml.
import { readFileSync, rmSync, writeFileSync } from "node:fs";
import { resolve } from "node:path";
import { pathToFileURL } from "node:url";

const [modules, ...files] = process.argv.slice(2);
const load = (path) => import(pathToFileURL(resolve(modules, path)));
const typescript = (await load("typescript/lib/typescript.js")).default;
const { parseAllDocuments } = (await load("yaml/dist/index.js")).default;
const KINDS = ["Deployment", "Service", "PodDisruptionBudget", "HorizontalPodAutoscaler", "NetworkPolicy"];

// What the compiler says of a file that declares every object with its type.
function checkTypes(objects) {
  const declared = objects.map((object, i) =>
    `import type { I${object.kind} as T${i} } from "kubernetes-models/${object.apiVersion}";\n` +
    `export const object${i}: T${i} = ${JSON.stringify(object)};\n`);
  const file = resolve(modules, "..", `manifests-${process.pid}.ts`);
  writeFileSync(file, declared.join(""));
  try {
    const program = typescript.createProgram([file], {
      noEmit: true, strict: true, skipLibCheck: true, types: [],
      module: typescript.ModuleKind.ESNext, moduleResolution: typescript.ModuleResolutionKind.Bundler });
    const [first] = typescript.getPreEmitDiagnostics(program);
    if (first) fail(typescript.flattenDiagnosticMessageText(first.messageText, " "));
  } finally {
    rmSync(file);
  }
}

async function checkValues({ apiVersion, kind, ...rest }) {
  const { [kind]: Model } = await load(`kubernetes-models/${apiVersion}/${kind}.js`);
  new Model({ apiVersion, kind, ...rest }).validate(); // throws
}

function fail(sentence) {
  throw new Error(sentence);
}

function selects(selector, labels) {
  return Object.entries(selector).every(([name, value]) => labels[name] === value);
}

// A peer of a NetworkPolicy that does not stand for everybody.
function selectsSome(peer) {
  return Object.values(peer).some((selector) => Object.keys(selector.matchLabels ?? {}).length > 0);
}

function checkDeployment(deployment) {
  const { spec, metadata } = deployment.spec.template;
  const [container] = spec.containers;
  if (!selects(deployment.spec.selector.matchLabels, metadata.labels)) fail("the Deployment does not select its pods");
  const drain = Number(container.env.find(({ name }) => name === "BARYCASTD_DRAIN_SECONDS").value);
  if (!(spec.terminationGracePeriodSeconds >= drain + 10))
    fail(`a pod has ${spec.terminationGracePeriodSeconds} s to end, its server ${drain} s to drain`);
  const grpc = container.ports.find(({ name }) => name === "grpc").containerPort;
  for (const name of ["startupProbe", "readinessProbe", "livenessProbe"]) {
    const probe = container[name] ?? fail(`there is no ${name}`);
    const good = probe.grpc
      ? probe.grpc.port === grpc && probe.grpc.service === "barycast.v1.BarycastService"
      : probe.exec?.command.join(" ") === "/usr/bin/barycastd --probe";
    if (!good) fail(`${name} asks for something else`);
  }
  const security = { ...spec.securityContext, ...container.securityContext };
  if (!security.runAsNonRoot || !security.readOnlyRootFilesystem || security.allowPrivilegeEscalation !== false ||
      security.seccompProfile?.type !== "RuntimeDefault" || !security.capabilities?.drop.includes("ALL"))
    fail("a pod is not confined");
  if (!(security.runAsUser > 0) || spec.automountServiceAccountToken !== false) fail("a pod is root, or has a token");
  const { periodSeconds, failureThreshold } = container.livenessProbe;
  if (!(periodSeconds * failureThreshold >= 30)) fail("liveness gives up within half a minute");
  const { requests, limits } = container.resources;
  if (!requests.cpu || !limits.cpu || !limits.memory || requests.memory !== limits.memory)
    fail("resources are not stated, or memory is overcommitted");
}

function checkTogether(objects) {
  const of = (kind) => objects.filter((object) => object.kind === kind);
  for (const kind of KINDS) if (of(kind).length === 0) fail(`there is no ${kind}`);
  const [deployment] = of("Deployment");
  const { labels } = deployment.spec.template.metadata;
  const { ports } = deployment.spec.template.spec.containers[0];
  checkDeployment(deployment);
  for (const service of of("Service")) {
    if (!selects(service.spec.selector, labels)) fail(`Service ${service.metadata.name} selects no pod`);
    const absent = service.spec.ports.find(({ targetPort }) => !ports.some(({ name }) => name === targetPort));
    if (absent) fail(`Service ${service.metadata.name}: no port ${absent.targetPort}`);
  }
  for (const budget of of("PodDisruptionBudget"))
    if (!selects(budget.spec.selector.matchLabels, labels)) fail("the PodDisruptionBudget selects no pod");
  for (const budget of of("PodDisruptionBudget"))
    if (budget.spec.maxUnavailable !== 1) fail("the PodDisruptionBudget lets several pods go");
  for (const policy of of("NetworkPolicy")) {
    if (!selects(policy.spec.podSelector.matchLabels, labels)) fail("the NetworkPolicy selects no pod");
    const open = policy.spec.ingress.some(({ from }) => !(from?.length > 0) || !from.every(selectsSome));
    if (open || policy.spec.egress?.length !== 0 || !policy.spec.policyTypes.includes("Egress"))
      fail("the NetworkPolicy is open");
    const opened = policy.spec.ingress.flatMap((rule) => rule.ports.map(({ port }) => port));
    const closed = opened.find((port) => !ports.some(({ containerPort }) => containerPort === port));
    if (closed) fail(`the NetworkPolicy opens ${closed}, which nobody has`);
  }
  for (const { spec } of of("HorizontalPodAutoscaler")) {
    if (spec.scaleTargetRef.name !== deployment.metadata.name) fail("the HorizontalPodAutoscaler scales nothing");
    if (deployment.spec.replicas !== undefined) fail("both the Deployment and its autoscaler state replicas");
    if (!spec.metrics.some(({ pods }) => pods?.metric.name.startsWith("barycastd_queue_wait_seconds")))
      fail("the HorizontalPodAutoscaler does not look at the queue wait");
  }
}

// A check that cannot fail is none: each change must be found, for its own reason.
async function selfTest(objects) {
  const changes = [
    [/readOnlyRoot/, (all) => { all.Deployment.spec.template.spec.containers[0].readOnlyRoot = true; }],
    [/minReplicas|not assignable/, (all) => { all.HorizontalPodAutoscaler.spec.minReplicas = "two"; }],
    [/30 s to end/, (all) => { all.Deployment.spec.template.spec.terminationGracePeriodSeconds = 30; }],
    [/no port http/, (all) => { all.Service.spec.ports[0].targetPort = "http"; }],
    [/no livenessProbe/, (all) => { delete all.Deployment.spec.template.spec.containers[0].livenessProbe; }],
    [/is root/, (all) => { all.Deployment.spec.template.spec.securityContext.runAsUser = 0; }],
    [/has a token/, (all) => { all.Deployment.spec.template.spec.automountServiceAccountToken = true; }],
    [/gives up/, (all) => { all.Deployment.spec.template.spec.containers[0].livenessProbe.failureThreshold = 1; }],
    [/several pods/, (all) => { all.PodDisruptionBudget.spec.maxUnavailable = "100%"; }],
    [/is open/, (all) => { delete all.NetworkPolicy.spec.ingress[0].from; }],
    [/is open/, (all) => { all.NetworkPolicy.spec.ingress[0].from = [{ podSelector: {} }]; }],
    [/is open/, (all) => { delete all.NetworkPolicy.spec.egress; }],
    [/no NetworkPolicy/, (all, list) => { list.splice(list.indexOf(all.NetworkPolicy), 1); }],
  ];
  for (const [reason, change] of changes) {
    const changed = structuredClone(objects);
    change(Object.fromEntries(changed.map((object) => [object.kind, object])), changed);
    let found = "nothing";
    try {
      await check(changed);
    } catch (error) {
      found = error.message;
    }
    if (!reason.test(found)) fail(`the check should find ${reason}, and finds ${found}`);
  }
}

async function check(objects) {
  checkTypes(objects);
  for (const object of objects) await checkValues(object);
  checkTogether(objects);
}

for (const file of files) {
  const documents = parseAllDocuments(readFileSync(file, "utf8"));
  for (const { errors } of documents) if (errors.length > 0) throw errors[0];
  const objects = documents.map((document) => document.toJS());
  await check(objects);
  await selfTest(objects);
}
console.log(`${files.length} manifests`);
