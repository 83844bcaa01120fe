!> Base type of jobs: options that were read and checked, a plan, a run that gives tables.
!!
!! The driver and the bindings use jobs only through this type. A new analysis extends `job_type` in
!! a separate file, and is named where scenes are read (`viscovib_scene_results`).
module viscovib_job
  use viscovib_kinds, only: wp
  use viscovib_number_text, only: exact
  use viscovib_status, only: status_type, things
  use viscovib_subject, only: subject_type
  use viscovib_table, only: table_type
  implicit none
  private

  public :: job_type, job_report, table_sink, plan_line, plan_unwanted, error_text

  type, abstract :: job_type
    !> The name of the group that requests it, and of its first table.
    character(len=:), allocatable :: kind
    !> Coordinates that the tables show.
    integer, allocatable :: wanted(:)
  contains
    procedure(plan_interface), deferred :: plan
    procedure(run_interface), deferred :: run
    procedure :: may_condense
  end type job_type

  type :: job_report
    !> A sentence about the result, and true if all of it was found.
    character(len=:), allocatable :: summary
    logical :: complete = .true.
  end type job_report

  !> Receiver of tables, called while their values exist.
  type, abstract :: table_sink
  contains
    procedure(put_interface), deferred :: put
  end type table_sink

  abstract interface

    !> Text of the plan: computed and skipped parts, with reasons, one per line.
    subroutine plan_interface(self, subject, text, status)
      import :: job_type, status_type, subject_type
      class(job_type), intent(in) :: self
      type(subject_type), intent(in), target :: subject
      character(len=:), allocatable, intent(out) :: text
      type(status_type), intent(out) :: status
    end subroutine plan_interface

    subroutine run_interface(self, subject, sink, report, status)
      import :: job_report, job_type, status_type, subject_type, table_sink
      class(job_type), intent(in) :: self
      type(subject_type), intent(in), target :: subject
      class(table_sink), intent(inout) :: sink
      type(job_report), intent(out) :: report
      type(status_type), intent(out) :: status
    end subroutine run_interface

    subroutine put_interface(self, name, table, status)
      import :: status_type, table_sink, table_type
      class(table_sink), intent(inout) :: self
      !> As in the names of files: "branch", "branch_1", "spectrum".
      character(len=*), intent(in) :: name
      type(table_type), intent(in) :: table
      type(status_type), intent(out) :: status
    end subroutine put_interface

  end interface

contains

  !> Whether the motions may be those of a condensed system, and whether stability is computed.
  subroutine may_condense(self, may, stability)
    class(job_type), intent(in) :: self
    logical, intent(out) :: may, stability
    may = .false. .and. same_type_as(self, self)
    stability = .false.
  end subroutine may_condense

  !> One line of a plan: what is done, or what is skipped.
  function plan_line(is_done, done, skipped) result(text)
    logical, intent(in) :: is_done
    character(len=*), intent(in) :: done, skipped
    character(len=:), allocatable :: text
    text = 'skips: '//skipped//new_line('a')
    if (is_done) text = 'computes: '//done//new_line('a')
  end function plan_line

  !> The line about columns or other results of coordinates that are not requested, if any.
  function plan_unwanted(what, subject, wanted) result(text)
    character(len=*), intent(in) :: what
    type(subject_type), intent(in) :: subject
    integer, intent(in) :: wanted(:)
    character(len=:), allocatable :: text
    integer :: i

    text = ''
    i = size(subject%coordinates) - size(wanted)
    if (subject%is_structure .and. i > 0) then
      text = 'skips: '//what//' of '//things(i, 'other coordinate')//' (not requested)' &
             //new_line('a')
      return
    end if
    do i = 1, size(subject%coordinates)
      if (all(wanted /= i)) text = text//', '//trim(subject%coordinates(i))
    end do
    if (text /= '') text = 'skips: '//what//' of '//text(3:)//' (not requested)'//new_line('a')
  end function plan_unwanted

  !> Text of an estimated error for the line above a table; empty if it is unknown (below 0).
  function error_text(error) result(text)
    real(wp), intent(in) :: error
    character(len=:), allocatable :: text
    text = ''
    if (error >= 0.0_wp) text = ', estimated error '//trim(exact(error))
  end function error_text

end module viscovib_job
