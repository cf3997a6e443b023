<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>
<!-- QGIS style for every layer of a GeoPackage of `ambush plan` or `ambush export`:
     Layer Properties, Style, Load Style. -->
<qgis version="3.22" styleCategories="Symbology">
  <renderer-v2 type="RuleRenderer" symbollevels="0" enableorderby="0">
    <rules key="{all}">
      <rule key="{routes}" symbol="0" label="routes, a colour each" filter="attribute('departure') IS NOT NULL OR attribute('share') IS NOT NULL"/>
      <rule key="{edges}" symbol="1" label="edges, darker if likelier" filter="attribute('probability') IS NOT NULL AND geometry_type($geometry) = 'Line'"/>
      <rule key="{sites}" symbol="2" label="ambush sites, larger if likelier" filter="attribute('probability') IS NOT NULL AND geometry_type($geometry) = 'Point'"/>
      <rule key="{held}" symbol="3" label="secured area" filter="attribute('radius') IS NOT NULL"/>
      <rule key="{places}" symbol="5" label="start, stops and goal" filter="attribute('name') IS NOT NULL AND geometry_type($geometry) = 'Point'"/>
      <rule key="{forbidden}" symbol="4" label="forbidden ground" filter="attribute('radius') IS NULL AND geometry_type($geometry) = 'Polygon'"/>
    </rules>
    <symbols>
      <symbol name="0" type="line"><layer class="SimpleLine" enabled="1"><Option type="Map">
        <Option name="line_width" type="QString" value="0.6"/>
        <Option name="joinstyle" type="QString" value="round"/>
      </Option><data_defined_properties><Option type="Map"><Option name="properties" type="Map">
        <Option name="outlineColor" type="Map">
          <Option name="active" type="bool" value="true"/>
          <Option name="expression" type="QString" value="color_hsl((coalesce(attribute('departure'), attribute('route')) * 137) % 360, 80, 40)"/>
          <Option name="type" type="int" value="3"/>
        </Option>
      </Option></Option></data_defined_properties></layer></symbol>
      <symbol name="1" type="line"><layer class="SimpleLine" enabled="1"><Option type="Map"/>
      <data_defined_properties><Option type="Map"><Option name="properties" type="Map">
        <Option name="outlineColor" type="Map">
          <Option name="active" type="bool" value="true"/>
          <Option name="expression" type="QString" value="ramp_color('Blues', 1 + 0.12 * ln(max(attribute('probability'), 0.001)))"/>
          <Option name="type" type="int" value="3"/>
        </Option>
        <Option name="outlineWidth" type="Map">
          <Option name="active" type="bool" value="true"/>
          <Option name="expression" type="QString" value="0.1 + 1.2 * attribute('probability')"/>
          <Option name="type" type="int" value="3"/>
        </Option>
      </Option></Option></data_defined_properties></layer></symbol>
      <symbol name="2" type="marker"><layer class="SimpleMarker" enabled="1"><Option type="Map">
        <Option name="name" type="QString" value="circle"/>
        <Option name="color" type="QString" value="230,97,0,255"/>
        <Option name="outline_color" type="QString" value="255,255,255,255"/>
      </Option><data_defined_properties><Option type="Map"><Option name="properties" type="Map">
        <Option name="size" type="Map">
          <Option name="active" type="bool" value="true"/>
          <Option name="expression" type="QString" value="1.5 + 6 * sqrt(attribute('probability'))"/>
          <Option name="type" type="int" value="3"/>
        </Option>
      </Option></Option></data_defined_properties></layer></symbol>
      <symbol name="3" type="fill"><layer class="SimpleFill" enabled="1"><Option type="Map">
        <Option name="style" type="QString" value="no"/>
        <Option name="outline_color" type="QString" value="0,0,0,255"/>
        <Option name="outline_style" type="QString" value="dash"/>
        <Option name="outline_width" type="QString" value="0.5"/>
      </Option></layer></symbol>
      <symbol name="4" type="fill"><layer class="SimpleFill" enabled="1"><Option type="Map">
        <Option name="color" type="QString" value="28,23,20,255"/>
        <Option name="outline_style" type="QString" value="no"/>
      </Option></layer></symbol>
      <symbol name="5" type="marker"><layer class="SimpleMarker" enabled="1"><Option type="Map">
        <Option name="name" type="QString" value="diamond"/>
        <Option name="color" type="QString" value="255,217,47,255"/>
        <Option name="outline_color" type="QString" value="0,0,0,255"/>
        <Option name="size" type="QString" value="4"/>
      </Option></layer></symbol>
    </symbols>
  </renderer-v2>
</qgis>
