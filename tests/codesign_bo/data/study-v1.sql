BEGIN TRANSACTION;
CREATE TABLE attempts (
    trial INTEGER NOT NULL REFERENCES trials, attempt INTEGER NOT NULL,
    started REAL NOT NULL, ended REAL, status TEXT, message TEXT, PRIMARY KEY (trial, attempt));
INSERT INTO "attempts" VALUES(0,1,1.79536542542318606381e+09,1.79536542542413592336e+09,'ok','');
INSERT INTO "attempts" VALUES(1,1,1.7953654254248862267e+09,1.79536542542572927477e+09,'ok','');
INSERT INTO "attempts" VALUES(2,1,1.79536542542826437949e+09,1.79536542542890310281e+09,'crash','leg too long');
INSERT INTO "attempts" VALUES(3,1,1.79536542543055415146e+09,1.79536542543130397801e+09,'diverged','loss is nan');
INSERT INTO "attempts" VALUES(4,1,1.79536542543307018281e+09,1.79536542543392872812e+09,'ok','');
INSERT INTO "attempts" VALUES(5,1,1795365426.23968,1.79536542624095606804e+09,'ok','');
INSERT INTO "attempts" VALUES(6,1,1.79536542673610258107e+09,NULL,NULL,NULL);
INSERT INTO "attempts" VALUES(6,2,1.79536542694110322002e+09,NULL,NULL,NULL);
CREATE TABLE confirmations (
    trial INTEGER NOT NULL REFERENCES trials, repeat INTEGER NOT NULL, seed INTEGER NOT NULL,
    attempts INTEGER NOT NULL, result TEXT, PRIMARY KEY (trial, repeat));
INSERT INTO "confirmations" VALUES(0,0,428483640,1,'{"curve": [[1.0, 0.1], [2.0, 0.5]], "extras": {"energy": 2.0}, "mean": 0.9041176303297668, "message": "", "n": 4, "sem": 0.03330356556330895, "status": "ok"}');
INSERT INTO "confirmations" VALUES(1,0,428483640,1,'{"curve": [[1.0, 0.1], [2.0, 0.5]], "extras": {"energy": 2.0}, "mean": 0.9641176303297667, "message": "", "n": 4, "sem": 0.03330356556330895, "status": "ok"}');
INSERT INTO "confirmations" VALUES(0,1,1016141897,1,'{"curve": [], "extras": {}, "mean": "nan", "message": "too slow", "n": 0, "sem": null, "status": "timeout"}');
INSERT INTO "confirmations" VALUES(1,1,1016141897,1,'{"curve": [[1.0, 0.1], [2.0, 0.5]], "extras": {"energy": 2.0}, "mean": 0.9833366032044214, "message": "", "n": 4, "sem": 0.021178052573278473, "status": "ok"}');
INSERT INTO "confirmations" VALUES(0,2,788713758,1,NULL);
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL);
INSERT INTO "meta" VALUES('schema_version','1');
INSERT INTO "meta" VALUES('header','{"space": [{"name": "thigh", "low": 0.6, "high": 1.4, "nominal": 1.0, "fixed": false}, {"name": "shank", "low": 0.5, "high": 1.5, "nominal": 1.0, "fixed": false}, {"name": "track", "low": 0.2, "high": 0.4, "nominal": 0.31, "fixed": true}], "seed": 7, "n_init": 5, "maximize": true}');
CREATE TABLE queue (
    position INTEGER PRIMARY KEY, params TEXT NOT NULL UNIQUE, trial INTEGER REFERENCES trials);
INSERT INTO "queue" VALUES(1,'{"thigh": 1.3, "shank": 0.7, "track": 0.31}',1);
INSERT INTO "queue" VALUES(2,'{"thigh": 0.9, "shank": 0.9, "track": 0.31}',NULL);
CREATE TABLE screening (position INTEGER PRIMARY KEY, params TEXT NOT NULL UNIQUE, value REAL NOT NULL);
INSERT INTO "screening" VALUES(1,'{"thigh": 1.3, "shank": 0.7, "track": 0.31}',0.9);
INSERT INTO "screening" VALUES(2,'{"thigh": 0.7, "shank": 1.3, "track": 0.31}',0.2);
CREATE TABLE trials (
    trial INTEGER PRIMARY KEY, params TEXT NOT NULL, seed INTEGER NOT NULL, origin TEXT NOT NULL,
    result TEXT);
INSERT INTO "trials" VALUES(0,'{"thigh": 1.0, "shank": 1.0, "track": 0.31}',600562731,'nominal','{"curve": [[1.0, 0.1], [2.0, 0.5]], "extras": {"energy": 2.0}, "mean": 0.93164341171381, "message": "", "n": 4, "sem": 0.019867032512826618, "status": "ok"}');
INSERT INTO "trials" VALUES(1,'{"thigh": 1.3, "shank": 0.7, "track": 0.31}',1809491585,'queued','{"curve": [[1.0, 0.1], [2.0, 0.5]], "extras": {"energy": 2.0}, "mean": 0.9870348949034085, "message": "", "n": 4, "sem": 0.021931056955186042, "status": "ok"}');
INSERT INTO "trials" VALUES(2,'{"thigh": 1.1196070276200771, "shank": 0.9836291912943125, "track": 0.31}',1915825222,'sobol','{"curve": [], "extras": {}, "mean": "nan", "message": "leg too long", "n": 0, "sem": null, "status": "crash"}');
INSERT INTO "trials" VALUES(3,'{"thigh": 0.9229023344814777, "shank": 1.2079510493203998, "track": 0.31}',1921100091,'sobol','{"curve": [], "extras": {"step": 12.0}, "mean": "nan", "message": "loss is nan", "n": 0, "sem": null, "status": "diverged"}');
INSERT INTO "trials" VALUES(4,'{"thigh": 0.8309925228357314, "shank": 0.8684288281947374, "track": 0.31}',978193900,'sobol','{"curve": [[1.0, 0.1], [2.0, 0.5]], "extras": {"energy": 1.6994213510304688}, "mean": 0.9130004868240029, "message": "", "n": 4, "sem": 0.021278701399622638, "status": "ok"}');
INSERT INTO "trials" VALUES(5,'{"thigh": 1.4, "shank": 0.5, "track": 0.31}',685027059,'surrogate','{"curve": [[1.0, 0.1], [2.0, 0.5]], "extras": {"energy": 1.9}, "mean": 0.9008791546591872, "message": "", "n": 4, "sem": 0.025910497810571333, "status": "ok"}');
INSERT INTO "trials" VALUES(6,'{"thigh": 1.3671741467147571, "shank": 0.7802190993516847, "track": 0.31}',1991085251,'surrogate',NULL);
COMMIT;
