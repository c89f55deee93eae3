<!DOCTYPE PickedPoints>
<PickedPoints>
 <point x="1" y="0" z="1" name="tip" active="1"/>
</PickedPoints>
