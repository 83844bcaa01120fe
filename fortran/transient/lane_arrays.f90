!> The workspace of a method that runs in lanes: states, stages and load phases in one array, in
!! columns of lanes.
module viscovib_lane_arrays
  use viscovib_explicit_tables, only: explicit_table_type
  use viscovib_kinds, only: wp
  use viscovib_lanes, only: max_dof, n_lanes
  implicit none
  private

  public :: furnish, new_work_plan, work_plan

  !> Offsets of the arrays in the workspace, in columns.
  type :: work_plan
    integer :: h = 1, q = 0, v = 0, q_rest = 0, v_rest = 0, in_q = 0, in_v = 0, stage_q = 0
    integer :: stage_v = 0, drive = 0, cosine = 0, sine = 0, stage_cosine = 0, stage_sine = 0
    !> For collocations only: accelerations of the previous step (after f), new accelerations, and
    !! coordinates at the nodes.
    integer :: f = 0, f_old = 0, f_new = 0, node_q = 0, n_columns = 0
  end type work_plan

contains

  !> Store steps and the load phases of the stages in the workspace.
  pure subroutine furnish(table, plan, frequencies, h, work)
    type(explicit_table_type), intent(in) :: table
    type(work_plan), intent(in) :: plan
    real(wp), intent(in) :: frequencies(:, :), h(n_lanes)
    real(wp), intent(inout) :: work(n_lanes, plan%n_columns)
    real(wp) :: angle
    integer :: i, j, k, column

    work(:, plan%h) = h
    do i = 1, table%n_stages
      do j = 1, size(frequencies, 2)
        column = size(frequencies, 2)*(i - 1) + j - 1
        work(:, plan%stage_cosine + column) = 1.0_wp
        work(:, plan%stage_sine + column) = 0.0_wp
        do k = 1, n_lanes
          angle = frequencies(k, j)*(h(k)*table%c(i))
          ! Stopped lanes, and constant loads: most of them when a single motion is computed.
          if (angle == 0.0_wp) cycle
          work(k, plan%stage_cosine + column) = cos(angle)
          work(k, plan%stage_sine + column) = sin(angle)
        end do
      end do
    end do
  end subroutine furnish

  pure type(work_plan) function new_work_plan(n_drives, n_stages, implicit) result(plan)
    integer, intent(in) :: n_drives, n_stages
    logical, intent(in) :: implicit
    plan%q = plan%h + 1
    plan%v = plan%q + max_dof
    plan%q_rest = plan%v + max_dof
    plan%v_rest = plan%q_rest + max_dof
    plan%in_q = plan%v_rest + max_dof
    plan%in_v = plan%in_q + max_dof
    plan%stage_q = plan%in_v + max_dof
    plan%stage_v = plan%stage_q + max_dof
    plan%drive = plan%stage_v + max_dof
    plan%cosine = plan%drive + n_drives
    plan%sine = plan%cosine + n_drives
    plan%stage_cosine = plan%sine + n_drives
    plan%stage_sine = plan%stage_cosine + n_drives*n_stages
    plan%f = plan%stage_sine + n_drives*n_stages
    plan%n_columns = plan%f + max_dof*n_stages - 1
    if (.not. implicit) return
    plan%f_old = plan%n_columns + 1
    plan%f_new = plan%f_old + max_dof*n_stages
    plan%node_q = plan%f_new + max_dof
    plan%n_columns = plan%node_q + max_dof*n_stages - 1
  end function new_work_plan

end module viscovib_lane_arrays
