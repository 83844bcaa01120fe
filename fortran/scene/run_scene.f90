!> Doing what a scene asks for.
module viscovib_run_scene
  use viscovib_files, only: stem
  use viscovib_job, only: job_report, table_sink
  use viscovib_locks, only: lock_texts, unlock_texts
  use viscovib_namelist, only: namelist_type, read_namelist
  use viscovib_scene, only: scene_type
  use viscovib_scene_groups, only: place_of
  use viscovib_status, only: fail, show, status_input_error, status_type
  use viscovib_table, only: table_type
  implicit none
  private

  public :: scene_report, compute_scene, plan_scene, run_scene

  type, extends(job_report) :: scene_report
    !> The first table written, which bears the name of what was asked for.
    character(len=:), allocatable :: path
  end type scene_report

  !> Tables as files of a folder, SCENE_NAME.csv.
  type, extends(table_sink) :: folder_sink
    character(len=:), allocatable :: folder, stem, header
  contains
    procedure :: put
  end type folder_sink

contains

  !> What will be computed and what is skipped, with the reasons.
  subroutine plan_scene(scene, text, status)
    type(scene_type), intent(in), target :: scene
    character(len=:), allocatable, intent(out) :: text
    type(status_type), intent(out) :: status

    text = ''
    if (scene%sweep_line > 0) then
      call fail(status, status_input_error, 'sweep', scene%path//':'//show(scene%sweep_line) &
                //': &sweep: sweeps are run by Python (viscovib sweep SCENE); this program runs ' &
                //'single points, leave the group out')
      return
    end if
    call lock_texts()
    call scene%job%plan(scene%subject, text, status)
    if (status%failed()) status%message = place(scene, status%subject)//status%message
    call unlock_texts()
  end subroutine plan_scene

  !> "path:line: ", the line of a key of what is wanted, or of its group; of a text that stands for
  !! the file, the line in the file, or none if it is not there.
  function place(scene, key)
    type(scene_type), intent(in) :: scene
    character(len=*), intent(in) :: key
    character(len=:), allocatable :: place
    type(namelist_type) :: file
    type(status_type) :: status
    integer :: n

    if (.not. scene%of_text) then
      place = scene%path//':'//show(scene%asked%line_of(key))//': '
      return
    end if
    place = scene%path//': '
    call read_namelist(scene%path, file, status)
    if (status%failed()) return
    n = place_of(file, scene%asked%name)
    if (n <= size(file%groups)) place = scene%path//':'//show(file%groups(n)%line_of(key))//': '
  end function place

  !> Compute what is wanted and write its tables into a folder.
  subroutine run_scene(scene, folder, version, report, status)
    type(scene_type), intent(in), target :: scene
    character(len=*), intent(in) :: folder, version
    type(scene_report), intent(out) :: report
    type(status_type), intent(out) :: status
    type(folder_sink) :: sink
    character(len=:), allocatable :: plan

    call plan_scene(scene, plan, status)
    if (status%failed()) return
    sink%folder = folder
    sink%stem = stem(scene%path)
    sink%header = 'viscovib '//version//', scene '//scene%path//new_line('a')//scene%title &
                  //new_line('a')//plan
    call compute_scene(scene, sink, report%job_report, status)
    report%path = folder//'/'//sink%stem//'_'//scene%job%kind//'.csv'
  end subroutine run_scene

  !> Compute what is wanted and give its tables to a sink.
  subroutine compute_scene(scene, sink, report, status)
    type(scene_type), intent(in), target :: scene
    class(table_sink), intent(inout) :: sink
    type(job_report), intent(out) :: report
    type(status_type), intent(out) :: status
    call scene%job%run(scene%subject, sink, report, status)
    if (status%failed() .and. status%category == status_input_error) then
      status%message = place(scene, status%subject)//status%message
    end if
  end subroutine compute_scene

  subroutine put(self, name, table, status)
    class(folder_sink), intent(inout) :: self
    character(len=*), intent(in) :: name
    type(table_type), intent(in) :: table
    type(status_type), intent(out) :: status
    call table%write(self%folder, self%stem//'_'//name//'.csv', self%header, status)
  end subroutine put

end module viscovib_run_scene
